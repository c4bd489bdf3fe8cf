"""Writing the outputs of a picture, atomically to files or to a stream."""

from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from depthcli.core.types import (
    DepthMap,
    DepthRange,
    Frame,
    displayed_depth,
    displayed_frame,
    has_depth,
)
from depthcli.errors import DepthcliError, OutputError, is_out_of_memory, os_errors_as
from depthcli.io.depth.metadata import anchor_fields, origin_fields
from depthcli.io.formats.table import FORMATS, Format, WriterOptions
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.temporary import temporary_folder


def write_output(
    options: WriterOptions, name: Format, depth: DepthMap, frame: Frame, path: Path
) -> tuple[str, ...]:
    """Write one format of an image's depth to a file, which a guard has checked.

    Depth is that of all pixels of the frame; only formats with a display window get the overscan.
    Returns warnings of one line.
    """
    with atomic_path(path) as temporary:
        return _write(options, name, depth, frame, temporary)


def write_stream(
    options: WriterOptions, name: Format, depth: DepthMap, frame: Frame, stream: BinaryIO
) -> tuple[str, ...]:
    """Write one format to a stream, as :func:`write_output`; BrokenPipeError as it comes."""
    # The libraries of the formats write files only.
    with temporary_folder() as folder:
        path = folder / f"depth{Path(FORMATS[name].suffix).suffix}"
        problem = f"cannot write a temporary file in {folder.parent}"
        with os_errors_as(OutputError, problem, "set TMPDIR to a folder with room"):
            warnings = _write(options, name, depth, frame, path)
            data = path.read_bytes()
    with os_errors_as(OutputError, "cannot write standard output"):
        stream.write(data)
        stream.flush()
    return warnings


def _write(
    options: WriterOptions, name: Format, depth: DepthMap, frame: Frame, path: Path
) -> tuple[str, ...]:
    if not name.facts.has_overscan:
        depth, frame = displayed_depth(depth, frame.windows), displayed_frame(frame)
    if not (has_depth(depth.values[::16, ::16], depth.kind).any() or depth.valid.any()):
        raise OutputError("no pixel has depth, so nothing is written")
    return options.writer(name).write(depth, path, frame)


def depth_facts(depth: DepthMap) -> dict[str, Any]:
    """Kind, unit, range and size of a map, its model and camera, for JSON."""
    return {
        "kind": depth.kind.value,
        "unit": depth.unit,
        **DepthRange.of(depth)._asdict(),
        "width": depth.width,
        "height": depth.height,
        **origin_fields(depth),
        **anchor_fields(depth),
    }


class FailedInput(NamedTuple):
    """An input that cannot be used, or whose outputs cannot be written."""

    name: str  #: the input, as the user wrote it
    error: DepthcliError  #: why


def failure_reason(error: Exception) -> str:
    """The reason why an input failed, in one line."""
    if isinstance(error, DepthcliError):
        return error.message
    if is_out_of_memory(error):
        return "does not fit into memory; make it smaller"
    if isinstance(error, OSError) and error.strerror:  # for example too many open files
        return ": ".join(filter(None, (error.filename and str(error.filename), error.strerror)))
    return f"unexpected {type(error).__name__}: {error}"
