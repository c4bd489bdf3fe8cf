"""The outputs of a picture: files that appear whole or not at all, or a stream."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from depthcli.io.storage.atomic import atomic_path
from depthcli.io.writers.formats import FORMATS

if TYPE_CHECKING:
    from typing import BinaryIO

    from depthcli.core.types import DepthMap, Frame
    from depthcli.io.writers.formats import Format
    from depthcli.io.writers.options import WriterOptions


def write_output(
    options: WriterOptions, name: Format, depth: DepthMap, frame: Frame, path: Path
) -> tuple[str, ...]:
    """Write one format of a picture's depth to a file.

    Returns:
        Warnings, one line each.

    Raises:
        OutputError: it cannot be written, or the picture is in its place.
    """
    inputs = () if frame.path is None else (frame.path,)
    with atomic_path(path, inputs=inputs) as temporary:
        return options.writer(name).write(depth, temporary, frame)


def write_stream(
    options: WriterOptions, name: Format, depth: DepthMap, frame: Frame, stream: BinaryIO
) -> tuple[str, ...]:
    """Write one format of a picture's depth to a stream.

    Returns:
        Warnings, one line each.
    """
    # The formats' libraries want a file, so there is one for a moment.
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"depth{Path(FORMATS[name].suffix).suffix}"
        warnings = options.writer(name).write(depth, path, frame)
        stream.write(path.read_bytes())
    stream.flush()
    return warnings
