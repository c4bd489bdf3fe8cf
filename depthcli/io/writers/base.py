"""What every output format is."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Protocol

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.core.types import DepthMap, Frame


class Writer(Protocol):
    """One output format with its options.

    Attributes:
        NAME: what ``--format`` calls it.
        SUFFIX: end of the default output name, after the input's stem.
        ENDINGS: file suffixes that choose this format when the user names a file.
    """

    NAME: ClassVar[str]
    SUFFIX: ClassVar[str]
    ENDINGS: ClassVar[tuple[str, ...]]

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write a depth map.

        Args:
            depth: the map.
            path: the file, straight as it is; callers make it atomic.
            frame: the picture it belongs to, for formats that show it.

        Returns:
            Warnings, one line each.

        Raises:
            OSError: the file cannot be written.
            OutputError: the map cannot be expressed in this format.
        """
        ...
