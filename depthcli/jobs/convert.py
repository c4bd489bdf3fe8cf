"""Converting a depth file to another format, and measuring the round-trip error."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.choices import MAX_PIXELS
from depthcli.core.map_camera import with_camera
from depthcli.core.overscan import displayed_frame
from depthcli.core.picture_options import AS_STATED, ReadOptions
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.depth.stored import StoredDepth
from depthcli.io.formats.table import FILE_SUFFIXES, MILLIMETRES, Format, WriterOptions, format_of
from depthcli.io.images.read import read_image
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.remote import check_writable, path_of, safe_name
from depthcli.jobs.depth_files import read_map
from depthcli.jobs.naming import check_suffix, is_folder, refuse_pattern
from depthcli.jobs.outputs import output_guard
from depthcli.video.number_pattern import is_pattern

_READABLE = (Format.PNG16, Format.EXR, Format.NPY)


@dataclass(frozen=True, slots=True)
class ConvertRequest:
    """A depth file, and how to convert it."""

    source: str  #: a depth map or a depth video
    target: str  #: the file to write; the suffix of the format is added where it is missing
    format: Format | None = None  #: of the target; None to take it from the suffix
    scale: float | None = None  #: units per metre of the source; None for what it states
    frame: int | None = None  #: of a depth video, from 0
    camera: Intrinsics = UNKNOWN_CAMERA  #: in place of that of the source; depth is not changed
    reading: ReadOptions = AS_STATED  #: how the picture is read
    #: of the same size, for the colours of a point cloud, or beside a preview
    picture: str | None = None
    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    overwrite: bool = False  #: whether the target may replace a file of another program


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """The error of the written file when it is read back, in the map's unit."""

    max_error: float  #: largest absolute error
    mean_error: float  #: mean absolute error
    lost: int  #: number of pixels that lost their depth

    @classmethod
    def of(cls, depth: DepthMap, read_back: DepthMap) -> Self:
        """The errors between two maps of the same size."""
        here, there = depth.valid, read_back.valid
        both = here & there
        error = np.abs(depth.values[both].astype(np.float64) - read_back.values[both])
        lost = int((here & ~there).sum())
        return cls(*(float(error.max()), float(error.mean())) if error.size else (0.0, 0.0), lost)


@dataclass(frozen=True, slots=True)
class ConvertResult:
    """The result of a conversion."""

    source: str  #: the input, as the user wrote it
    target: str  #: the file that was written
    depth: DepthMap  #: what was written, of an EXR its display window
    round_trip: RoundTrip | None  #: round-trip error; None for a format that is not read back
    warnings: tuple[str, ...]  #: one line each


def convert(request: ConvertRequest) -> ConvertResult:
    """Write a depth file in another format.

    Raises:
        InputError: the source or the picture cannot be used.
        OutputError: the target cannot be written, is an input, or is a file that depthcli did not
            write.
        UsageError: the target's suffix is of no format, or it is a pattern and the name of the
            source is none, or the request does not fit the source.
    """
    if not is_pattern(path_of(request.source).name):
        refuse_pattern("", request.target)
    stored = read_map(path_of(request.source), scale=request.scale, frame=request.frame)
    return write_converted(stored, request)


def write_converted(stored: StoredDepth, request: ConvertRequest) -> ConvertResult:
    """Write a map that was read from the source of a request; raises the errors of `convert`."""
    wanted = target_format(request.target, request.format)
    shown = with_camera(stored.displayed, request.camera)
    given = None if request.picture is None else _colours(request, request.picture, shown)
    picture = given
    if wanted.facts.has_overscan:
        depth, picture = replace(stored.depth, provenance=shown.provenance), stored.frame
    else:
        depth = shown
    inputs = [path_of(name) for name in (request.source, request.picture) if name is not None]
    name = request.target
    check_writable(path_of(name))
    if not format_of(name):
        name += wanted.facts.suffix
    guard = output_guard(inputs, overwrite=request.overwrite)
    with atomic_path(path_of(name), guard=guard) as temporary:
        writing = _sidecar_options(request, stored) if wanted is Format.JSON else request.writing
        warnings = writing.writer(wanted).write(depth, temporary, picture)
        is_readable = wanted in _READABLE
        read_back = read_stored_depth(temporary, kind=depth.kind).depth if is_readable else None
    round_trip = None if read_back is None else RoundTrip.of(depth, read_back)
    of_picture = given.warnings if given else ()
    warnings = (*stored.warnings_with_scale("--from-scale"), *of_picture, *warnings)
    return ConvertResult(safe_name(request.source), name, shown, round_trip, warnings)


def target_format(target: str, asked: Format | None) -> Format:
    """The format to write: the requested one, else that of the target's suffix.

    Raises:
        UsageError: the suffix is of no format or another one, or the target is not a file.
    """
    if target == "-" or is_folder(target):
        folder = "" if target == "-" else f"{target.rstrip('/')}/"
        raise UsageError(f"{target} is not a file; name one, for example {folder}depth.exr")
    if asked is not None:
        check_suffix("", target, asked)
    found = asked or format_of(target)
    if found is None:
        raise UsageError(
            f"{target} has no suffix that selects a format; use {', '.join(FILE_SUFFIXES)}, "
            "or give --format"
        )
    return found


def _sidecar_options(request: ConvertRequest, stored: StoredDepth) -> WriterOptions:
    """The options; by default, the sidecar of a 16-bit PNG states the scale of that PNG."""
    writing = request.writing
    if stored.metadata.get("scale") == "normalized":
        return replace(writing, png_normalize=True)
    if stored.scale is None or writing.png_scale != MILLIMETRES:
        return writing
    return replace(writing, png_scale=stored.scale.units_per_metre)


def _colours(request: ConvertRequest, picture: str, depth: DepthMap) -> Frame:
    limit = max(MAX_PIXELS, depth.values.size)
    options = request.reading._asdict()
    frame = displayed_frame(read_image(picture, max_pixels=limit, **options))
    if (frame.width, frame.height) != (depth.width, depth.height):
        raise InputError(
            f"{picture} has {frame.width}×{frame.height} pixels and the depth "
            f"{depth.width}×{depth.height}; give the picture that the depth was made of"
        )
    return frame
