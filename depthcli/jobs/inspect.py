"""Facts about a depth file, and its depth at a pixel."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from depthcli.core.types import DepthMap, DepthRange, Window
from depthcli.errors import UsageError
from depthcli.io.depth.read import StoredDepth, read_stored_depth
from depthcli.io.depth.scale import depth_scale
from depthcli.io.storage.paths import path_of, safe_name
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.convert import is_depth_video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.frames import FALLBACK_RATE, rate_text
from depthcli.video.time_code import time_code_text


@dataclass(frozen=True, slots=True)
class DepthMapInfo:
    """Facts about a depth map."""

    input: str  #: the file, as the user wrote it
    kind: str  #: metric, relative or inverse
    unit: str | None  #: ``m``; None for relative and inverse maps
    scale: float | None  #: units per metre; None if the file does not hold such integers
    scale_source: str | None  #: ``file``, ``option`` or ``assumed``; None without a scale
    channel: str | None  #: that of an EXR which holds the depth; None for other files
    width: int  #: columns
    height: int  #: rows
    valid: int  #: pixels with depth
    min: float | None  #: smallest depth; None if no pixel has depth
    median: float | None  #: median depth, or None
    max: float | None  #: largest depth, or None
    #: metadata of the file and its sidecar; of an EXR, also its windows, rate and time code
    metadata: Mapping[str, str]
    warnings: tuple[str, ...]  #: one line each


@dataclass(frozen=True, slots=True)
class DepthVideoInfo:
    """Facts about a depth video."""

    input: str  #: the file, as the user wrote it
    kind: str  #: metric, relative or inverse
    unit: str | None  #: ``m``; None if the video is not metric
    scale: float | None  #: units per metre; None if the video is normalized
    scale_source: str | None  #: ``file``, ``option`` or ``assumed``; None without a scale
    width: int  #: columns
    height: int  #: rows
    frames: int  #: number of frames
    fps: str | None  #: frames per second, exact; None if it is not stated
    valid: int  #: pixels with depth, in all frames
    min: float | None  #: smallest depth; None if no pixel has depth
    max: float | None  #: largest depth, or None
    metadata: Mapping[str, str]  #: metadata of the file


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
    """What the header of an EXR states for compositing, by the names of its attributes."""
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
        known = depth.values[depth.valid]
        frames, valid = frames + 1, valid + known.size
        height, width = depth.values.shape
        low = min(low, float(known.min(initial=np.inf)))
        high = max(high, float(known.max(initial=-np.inf)))
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
