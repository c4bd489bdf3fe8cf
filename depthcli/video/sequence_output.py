"""A video's depth as a file for each frame."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from depthcli.errors import OutputError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.writers.base import Writer
from depthcli.video.output import VideoFrame


class SequenceOutput:
    """A file for each frame, in one of the formats of pictures; each appears when it is done."""

    def __init__(
        self,
        label: str,
        folder: Path,
        name: Callable[[int], str],
        writer: Writer,
        inputs: Sequence[Path],
    ) -> None:
        """Name where frames go: ``name`` gives a file's name for a frame's number.

        Warnings call the format ``label``; inputs are not replaced.
        """
        self._label = label
        self._folder = folder
        self._name = name
        self._writer = writer
        self._inputs = frozenset(os.path.realpath(path) for path in inputs)
        self._warned = 0
        self._warning = ""

    def encode(self, frame: VideoFrame) -> tuple[str, ...]:
        """Write the file; the order of files does not matter."""
        if frame.is_kept:
            return ()
        path = self._folder / self._name(frame.picture.index)
        if os.path.realpath(path) in self._inputs:
            raise OutputError(f"{path} is an input and is not overwritten; choose another --out")
        with atomic_path(path) as temporary:
            return self._writer.write(frame.depth, temporary, frame.picture)

    def append(self, encoded: tuple[str, ...]) -> None:
        """Remember the first warning, and count them."""
        if encoded:
            self._warning = self._warning or encoded[0]
            self._warned += 1

    def finish(self) -> tuple[str, ...]:
        """Say the first warning once."""
        if not self._warned:
            return ()
        return (f"{self._label}: {self._warned} frames, the first: {self._warning}",)
