"""What the numbers of a depth file mean, and what they are at a pixel."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from depthcli.core.summary import DepthRange
from depthcli.core.types import DepthMap
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.facts import stated_facts
from depthcli.io.depth.read import read_depth
from depthcli.io.storage.remote import path_of, safe_name
from depthcli.io.storage.transfer import local_copy
from depthcli.video.depth import DepthVideo
from depthcli.video.rates import rate_text

_VIDEO_SUFFIX = ".mkv"


@dataclass(frozen=True, slots=True)
class MapFacts:
    """What the numbers of a depth map mean."""

    input: str  #: the file, as the user wrote it
    kind: str  #: metric, relative or inverse
    unit: str | None  #: ``m``; None for relative and inverse maps
    width: int  #: columns
    height: int  #: rows
    valid: int  #: pixels with depth
    min: float | None  #: least depth; None where there is none
    median: float | None  #: in the middle of them; None likewise
    max: float | None  #: largest; None likewise
    metadata: Mapping[str, str]  #: what the file states


@dataclass(frozen=True, slots=True)
class VideoFacts:
    """What the numbers of a depth video mean."""

    input: str  #: the file, as the user wrote it
    kind: str  #: metric, relative or inverse
    unit: str | None  #: ``m``; None where the video has none
    width: int  #: columns
    height: int  #: rows
    frames: int  #: how many there are
    fps: str | None  #: frames a second, exact; None if it is not stated
    valid: int  #: pixels with depth, of all frames
    min: float | None  #: least depth; None where there is none
    max: float | None  #: largest depth; None likewise
    metadata: Mapping[str, str]  #: what the file states


def inspect_file(file: str, scale: float | None = None) -> MapFacts | VideoFacts:
    """Unit, scale, size, range and model of a depth file; all of it is read.

    ``scale`` is in steps a metre of a PNG or a video; None for what the file states.

    Raises:
        InputError: missing, damaged or without depth.
        UsageError: a scale for a file that holds metres as they are.
    """
    path = path_of(file)
    _check_scale(path, scale)
    if _is_video(path):
        with local_copy(path) as video:
            return _facts_of(DepthVideo(video, scale=scale), safe_name(file))
    depth = read_depth(path, png_scale=scale)
    return MapFacts(
        input=safe_name(file),
        kind=depth.kind.value,
        unit="m" if depth.is_metric else None,
        width=depth.width,
        height=depth.height,
        valid=int(np.isfinite(depth.values).sum()),
        **DepthRange.of(depth)._asdict(),
        metadata=stated_facts(path),
    )


def read_map(path: Path, *, scale: float | None = None, frame: int | None = None) -> DepthMap:
    """A depth map from any file that depthcli writes, or the frame of that number in a video.

    ``scale`` is in steps a metre of a PNG or a video; None for what the file states.

    Raises:
        InputError: missing, damaged, without depth, or shorter than that.
        UsageError: a video without the number of a frame, or a number or a scale for another file.
    """
    _check_scale(path, scale)
    if _is_video(path):
        if frame is None:
            raise UsageError(f"{path} is a video; say which frame with --frame, 0 for the first")
        with local_copy(path) as video:
            return _video_frame(video, scale, frame)
    if frame is not None:
        raise UsageError(f"--frame is for depth videos (.mkv), but {path} is not one; remove it")
    return read_depth(path, png_scale=scale)


def depth_at(depth: DepthMap, x: int, y: int) -> float | None:
    """Depth at a column and a row; None where there is none.

    Raises:
        UsageError: the pixel is outside the map.
    """
    if x >= depth.width or y >= depth.height:
        raise UsageError(f"{x},{y} is outside the map of {depth.width}×{depth.height} pixels")
    value = float(depth.values[y, x])
    return value if math.isfinite(value) else None


def _is_video(path: Path) -> bool:
    return path.suffix.lower() == _VIDEO_SUFFIX


def _check_scale(path: Path, scale: float | None) -> None:
    """Refuse a scale for a file that holds metres as they are."""
    if scale is not None and path.suffix.lower() != ".png" and not _is_video(path):
        raise UsageError(
            f"a scale is for PNG and depth videos (.mkv), but {path} is neither; remove it"
        )


def _video_frame(path: Path, scale: float | None, number: int) -> DepthMap:
    count = 0
    for count, depth in enumerate(DepthVideo(path, scale=scale), start=1):
        if count > number:
            return depth
    raise InputError(f"{path} has no frame {number}; its last one is {count - 1}")


def _facts_of(video: DepthVideo, file: str) -> VideoFacts:
    frames = valid = width = height = 0
    low, high = math.inf, -math.inf
    for depth in video:
        known = depth.values[np.isfinite(depth.values)]
        frames, valid = frames + 1, valid + known.size
        height, width = depth.values.shape
        low = min(low, float(known.min(initial=np.inf)))
        high = max(high, float(known.max(initial=-np.inf)))
    return VideoFacts(
        input=file,
        kind=video.kind.value,
        unit=None if video.scale is None else "m",
        width=width,
        height=height,
        frames=frames,
        fps=None if video.rate is None else rate_text(video.rate),
        valid=valid,
        min=low if valid else None,
        max=high if valid else None,
        metadata=video.labels,
    )
