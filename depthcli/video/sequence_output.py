"""Writing a video's depth to one file a frame."""

from collections.abc import Callable
from pathlib import Path

from depthcli.io.formats.table import Writer
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.guard import Guard
from depthcli.video.output import DepthFrame


class SequenceOutput:
    """One file a frame, in one of the formats of pictures, each written atomically."""

    def __init__(
        self,
        label: str,
        folder: Path,
        name: Callable[[int], str],
        writer: Writer,
        guard: Guard,
        *,
        has_overscan: bool = False,
    ) -> None:
        """Prepare the output.

        Args:
            label: name of the format in warnings.
            folder: where files are written.
            name: the name of a file by the frame's number.
            writer: of the format.
            guard: of existing files.
            has_overscan: whether frames include the pixels outside the display window.
        """
        self.has_overscan = has_overscan
        self._label = label
        self._folder = folder
        self._name = name
        self._writer = writer
        self._guard = guard
        self._warned = 0
        self._warning = ""

    def encode(self, frame: DepthFrame) -> tuple[str, ...]:
        """Write the file; in any order."""
        if frame.is_kept:
            return ()
        path = self._folder / self._name(frame.picture.index)
        with atomic_path(path, guard=self._guard) as temporary:
            return self._writer.write(frame.depth, temporary, frame.picture)

    def append(self, encoded: tuple[str, ...]) -> None:
        """Remember the first warning, and count them."""
        if encoded:
            self._warning = self._warning or encoded[0]
            self._warned += 1

    def finish(self) -> tuple[str, ...]:
        """Return the first warning, with their number."""
        if not self._warned:
            return ()
        return (f"{self._label}: {self._warned} frames, the first: {self._warning}",)
