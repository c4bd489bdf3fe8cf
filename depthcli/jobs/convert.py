"""A depth file in another format, and what that costs."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from depthcli.core import scaling
from depthcli.core.camera import Camera
from depthcli.core.types import CameraSource, DepthMap, Frame, Provenance
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_depth
from depthcli.io.pictures.read import read_image
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.remote import check_writable, path_of, safe_name
from depthcli.io.writers.formats import ENDINGS, Format, format_of
from depthcli.io.writers.options import WriterOptions
from depthcli.jobs.inspect import read_map
from depthcli.jobs.naming import check_fit, is_folder

_READABLE = (Format.PNG16, Format.EXR, Format.NPY)


@dataclass(frozen=True, slots=True)
class ConvertRequest:
    """A depth file, and what is to be made of it."""

    source: str  #: a map, or a depth video
    target: str  #: the file to write; a name without suffix gets that of the format
    format: Format | None = None  #: of the target; None for what its suffix says
    scale: float | None = None  #: steps a metre of the source; None for what it states
    frame: int | None = None  #: of a depth video, from 0
    #: of a point cloud, in place of the one that the source states; depth stays as it is
    camera: Camera = field(default_factory=Camera)
    picture: str | None = None  #: of the same size, for the colours of a point cloud
    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """How far what is read back is from what was written, in the map's unit."""

    max_error: float  #: largest distance
    mean_error: float  #: mean distance
    lost: int  #: pixels that no longer have depth

    @classmethod
    def of(cls, depth: DepthMap, again: DepthMap) -> Self:
        """The distance of two maps of one size."""
        here, there = np.isfinite(depth.values), np.isfinite(again.values)
        both = here & there
        gap = np.abs(depth.values[both].astype(np.float64) - again.values[both])
        lost = int((here & ~there).sum())
        return cls(*(float(gap.max()), float(gap.mean())) if gap.size else (0.0, 0.0), lost)


@dataclass(frozen=True, slots=True)
class Converted:
    """A file that was converted."""

    source: str  #: the input, as the user wrote it
    target: str  #: the file that was written
    depth: DepthMap  #: what was written
    round_trip: RoundTrip | None  #: what that cost; None for a format that is not read back
    warnings: tuple[str, ...]  #: one-line texts


def convert(request: ConvertRequest) -> Converted:
    """Write a depth file in another format.

    Raises:
        InputError: the source or the picture cannot be used.
        OutputError: the target cannot be written, or is an input.
        UsageError: the target says no format, or the request does not fit the source.
    """
    wanted = target_format(request.target, request.format)
    depth = read_map(path_of(request.source), scale=request.scale, frame=request.frame)
    depth = _seen_by(depth, request.camera)
    colours = None if request.picture is None else _colours(request.picture, depth)
    inputs = [path_of(name) for name in (request.source, request.picture) if name is not None]
    name = request.target
    name += "" if path_of(name).suffix else wanted.facts.suffix
    target = path_of(name)
    check_writable(target)
    with atomic_path(target, inputs=inputs) as temporary:
        warnings = request.writing.writer(wanted).write(depth, temporary, colours)
        again = read_depth(temporary) if wanted in _READABLE else None
    round_trip = None if again is None else RoundTrip.of(depth, again)
    return Converted(safe_name(request.source), name, depth, round_trip, warnings)


def target_format(target: str, asked: Format | None) -> Format:
    """The format to write: the one asked for, else what the target's name says.

    Raises:
        UsageError: it says none or another one, or is no file.
    """
    if target == "-" or is_folder(target):
        folder = "" if target == "-" else f"{target.rstrip('/')}/"
        raise UsageError(f"{target} is not a file; name one, for example {folder}depth.exr")
    if asked is not None:
        check_fit("", target, asked)
    found = asked or format_of(target)
    if found is None:
        raise UsageError(
            f"{target} has no suffix that selects a format; use {', '.join(ENDINGS)}, or give "
            "--format"
        )
    return found


def _seen_by(depth: DepthMap, camera: Camera) -> DepthMap:
    """The same depth with a camera that is given in place of the stated one."""
    focal_px = camera.focal_px
    if camera.hfov_deg is not None:
        focal_px = scaling.focal_px_of_hfov(camera.hfov_deg, depth.width)
    if focal_px is None:
        return depth
    source = replace(
        depth.provenance or Provenance(), focal_px=focal_px, camera_source=CameraSource.OPTION
    )
    return replace(depth, provenance=source)


def _colours(picture: str, depth: DepthMap) -> Frame:
    frame = read_image(picture)
    if (frame.width, frame.height) != (depth.width, depth.height):
        raise InputError(
            f"{picture} has {frame.width}×{frame.height} pixels and the depth "
            f"{depth.width}×{depth.height}; give the picture that the depth was made of"
        )
    return frame
