"""Real paths of files, to recognize two names of one file."""

import os
from functools import cache
from pathlib import Path


class RealPaths:
    """Resolves links, with a cache of folders; short-lived, as folders and links change."""

    def __init__(self) -> None:
        self._real_folder = cache(os.path.realpath)

    def of(self, path: str | Path) -> str:
        """The path with links in its folder resolved; if the file is a link, that is kept."""
        folder, name = os.path.split(path)
        return os.path.join(self._real_folder(folder), name)  # noqa: PTH118

    def all_of(self, path: str | Path) -> set[str]:
        """The same, and the target if the file is a link."""
        own = self.of(path)
        return {own, os.path.realpath(own)} if os.path.islink(own) else {own}  # noqa: PTH114
