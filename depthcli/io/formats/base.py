"""The interface of output formats."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.core.types import DepthMap, Frame


class Writer(Protocol):
    """One output format with its options; its name and suffix are in the table of formats."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write a depth map.

        Args:
            depth: the map.
            path: the file, written in place; callers make it atomic.
            frame: the picture it belongs to, for formats that show it.

        Returns:
            Warnings, one line each.

        Raises:
            OSError: the file cannot be written.
            OutputError: the map cannot be expressed in this format.
        """
