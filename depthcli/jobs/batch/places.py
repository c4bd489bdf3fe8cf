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
