"""Reading a depth map from any depth file, facts about it, and its depth at a pixel."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from depthcli.core.types import DepthMap, DepthRange, Window
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import StoredDepth, read_stored_depth
from depthcli.io.depth.scale import depth_scale
from depthcli.io.storage.paths import local_copy, path_of, safe_name
from depthcli.video.depth_video import DepthVideo
from depthcli.video.frames import FALLBACK_RATE, rate_text
from depthcli.video.time_code import time_code_text

_VIDEO_SUFFIX = ".mkv"


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthFileInfo:
    """Facts about a depth file."""

    input: str  #: the file, as the user wrote it
    kind: str  #: metric, relative or inverse
    unit: str | None  #: ``m``; None for relative and inverse depth
    scale: float | None  #: units per metre; None if the file does not hold such integers
    scale_source: str | None  #: ``file``, ``option`` or ``assumed``; None without a scale
    width: int  #: columns
    height: int  #: rows
    valid: int  #: pixels with depth, of a video in all frames
    min: float | None  #: smallest depth; None if no pixel has depth
    max: float | None  #: largest depth, or None
    #: metadata of the file and its sidecar; of an EXR, also its windows, rate and time code
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthMapInfo(DepthFileInfo):
    """Facts about a depth map."""

    channel: str | None  #: that of an EXR which holds the depth; None for other files
    median: float | None  #: median depth, or None
    warnings: tuple[str, ...]  #: one line each


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthVideoInfo(DepthFileInfo):
    """Facts about a depth video."""

    frames: int  #: number of frames
    fps: str | None  #: frames per second, exact; None if it is not stated


def is_depth_video(path: Path) -> bool:
    """Whether a file is a depth video, by its suffix."""
    return path.suffix.lower() == _VIDEO_SUFFIX


def read_map(path: Path, *, scale: float | None = None, frame: int | None = None) -> StoredDepth:
    """A depth map from any file that depthcli writes; for a video, that of frame number ``frame``.

    ``scale`` is units per metre of integers; None for what the file states.

    Raises:
        InputError: missing, damaged, without depth, or a video without this frame.
        UsageError: a video without a frame number, or a frame number or scale for another file.
    """
    if is_depth_video(path):
        if frame is None:
            raise UsageError(
                f"{path} is a video",
                "name one frame with {frame}, 0 for the first ('convert' writes all to a pattern "
                "such as depth.%04d.exr)",
            )
        with local_copy(path) as video:
            return _video_frame(DepthVideo(video, scale=scale), str(path), frame)
    if frame is not None:
        raise UsageError(f"{path} is no depth video (.mkv)", "remove it", option="frame")
    return read_stored_depth(path, png_scale=scale)


def _video_frame(video: DepthVideo, name: str, number: int) -> StoredDepth:
    count = 0
    for count, stored in enumerate(video.frames(name), start=1):
        if count > number:
            return stored
    raise InputError(f"{name} has no frame {number}; its last one is {count - 1}")


def inspect_file(file: str, scale: float | None = None) -> DepthMapInfo | DepthVideoInfo:
    """Unit, scale, size, range and model of a depth file, which is read completely.

    ``scale`` is units per metre of integers; None for what the file states.

    Raises:
        InputError: missing, damaged or without depth.
        UsageError: a scale for a file that stores metres.
    """
    path = path_of(file)
    if is_depth_video(path):
        with local_copy(path) as video:
            return _video_info(DepthVideo(video, scale=scale), safe_name(file), scale)
    stored = read_stored_depth(path, png_scale=scale)
    depth = stored.displayed
    stated, source = stored.scale or (None, None)
    return DepthMapInfo(
        input=safe_name(file),
        kind=depth.kind.value,
        unit="m" if depth.is_metric else None,
        scale=stated,
        scale_source=source,
        channel=stored.channel,
        width=depth.width,
        height=depth.height,
        valid=int(depth.valid.sum()),
        **DepthRange.of(depth)._asdict(),
        metadata={**stored.metadata, **_exr_facts(stored)},
        warnings=stored.warnings,
    )


def depth_at(depth: DepthMap, x: int, y: int) -> float | None:
    """Depth at a column and a row; None if the pixel has none.

    Raises:
        UsageError: the pixel is outside the map.
    """
    if x >= depth.width or y >= depth.height:
        raise UsageError(f"{x},{y} is outside the map of {depth.width}×{depth.height} pixels")
    return float(depth.values[y, x]) if depth.valid[y, x] else None


def _exr_facts(stored: StoredDepth) -> dict[str, str]:
    """Facts for compositing in the header of an EXR, by the names of its attributes."""
    frame = stored.frame
    if stored.channel is None or frame.windows is None:
        return {}
    facts = {
        "dataWindow": _window_text(frame.windows.data),
        "displayWindow": _window_text(frame.windows.display),
        "pixelAspectRatio": f"{frame.pixel_aspect:.6g}",
    }
    if frame.rate is not None:
        facts["framesPerSecond"] = rate_text(frame.rate)
    if frame.time_code is not None:
        facts["timeCode"] = time_code_text(frame.time_code, frame.rate or FALLBACK_RATE)
    return facts


def _window_text(window: Window) -> str:
    """The first and the last pixel, as the header has them."""
    return f"{window.left},{window.top} to {window.right - 1},{window.bottom - 1}"


def _video_info(video: DepthVideo, file: str, scale: float | None) -> DepthVideoInfo:
    frames = valid = width = height = 0
    low, high = math.inf, -math.inf
    for depth in video:
        valid_depth = depth.values[depth.valid]
        frames, valid = frames + 1, valid + valid_depth.size
        height, width = depth.values.shape
        low = min(low, float(valid_depth.min(initial=np.inf)))
        high = max(high, float(valid_depth.max(initial=-np.inf)))
    stated, source = depth_scale(video.labels, scale) or (None, None)
    return DepthVideoInfo(
        input=file,
        kind=video.kind.value,
        unit=None if video.scale is None else "m",
        scale=stated,
        scale_source=source,
        width=width,
        height=height,
        frames=frames,
        fps=None if video.rate is None else rate_text(video.rate),
        valid=valid,
        min=low if valid else None,
        max=high if valid else None,
        metadata=video.labels,
    )
