"""Where files really are, so that two names of one file are seen to be one."""

import os
from functools import cache
from pathlib import Path


class Places:
    """Looks folders up once each; for one purpose only, as folders and links change."""

    def __init__(self) -> None:
        self._real_folder = cache(os.path.realpath)

    def of(self, path: str | Path) -> str:
        """A file's own place: links to its folder are followed, one that it is is not."""
        folder, name = os.path.split(path)
        return os.path.join(self._real_folder(folder), name)  # noqa: PTH118

    def all_of(self, path: str | Path) -> set[str]:
        """A file's own place, and that of the file which it leads to if it is a link."""
        own = self.of(path)
        return {own, os.path.realpath(own)} if os.path.islink(own) else {own}  # noqa: PTH114
