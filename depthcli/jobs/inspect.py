"""Reading a depth map from any depth file, facts about it, its depth at a pixel or in an area."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core.surface import holds_edge, surface_of
from depthcli.core.types import BoolArray, DepthMap, range_facts
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.images.read import read_image
from depthcli.io.storage.paths import local_copy, path_of, safe_name
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions, StoredDepth
from depthcli.video.depth_video import DepthVideo
from depthcli.video.frames import FALLBACK_RATE, rate_text, time_code_text

_STACKS = (".npy", ".npz")
_REACH_PX, _SAME_SURFACE = 8, 0.05  # around a pixel whose normal is measured, and of its depth


def is_depth_video(path: Path) -> bool:
    """Whether a file is a depth video, by its suffix."""
    return path.suffix.lower() == ".mkv"


def open_depth_video(path: Path, options: DepthReadOptions) -> DepthVideo:
    """A depth video whose scale the user may state; UsageError if more is stated."""
    if options.kind is not None:
        raise UsageError("it is for depth maps, not for videos", option="from_kind")
    return DepthVideo(path, scale=options.scale)


def read_map(path: Path, options: DepthReadOptions = AS_STATED) -> StoredDepth:
    """A depth map from any file that depthcli reads; of a depth video, the frame of the options.

    InputError if it is missing, damaged, without depth or this frame; UsageError for a video
    without a frame number, or a frame number for a file of one map.
    """
    if is_depth_video(path):
        if options.frame is None:
            raise UsageError(
                f"{path} is a video",
                "name one frame with {frame}, 0 for the first ('convert' writes all to a pattern "
                "such as depth.%04d.exr)",
            )
        with local_copy(path) as video:
            count = 0
            for count, stored in enumerate(open_depth_video(video, options).frames(str(path)), 1):
                if count > options.frame:
                    return stored
            raise InputError(f"{path} has no frame {options.frame}; its last one is {count - 1}")
    if options.frame is not None and path.suffix.lower() not in _STACKS:
        raise UsageError(f"{path} is one map", "remove it", option="frame")
    return read_stored_depth(path, options)


def inspect_file(file: str, options: DepthReadOptions = AS_STATED) -> dict[str, object]:
    """Facts about a depth file, which is read completely, by name.

    ``unit`` is ``m``, None for relative and inverse depth; ``scale`` is units per metre in the
    file, stated by ``scale_source``; ``valid`` counts pixels with depth, of a video in all frames.
    """
    path = path_of(file)
    if is_depth_video(path) and options.frame is None:
        with local_copy(path) as video:
            return {"input": safe_name(file), **_video_facts(open_depth_video(video, options))}
    stored = read_map(path, options)
    depth, (scale, source) = stored.displayed, stored.scale or (None, None)
    # The scale of integers is among the facts.
    with_scale = () if stored.is_integer else stored.warnings_with_scale("from_scale")
    return {
        "input": safe_name(file),
        "kind": depth.kind.value,
        "unit": depth.unit,
        "scale": scale,
        "scale_source": source,
        "width": depth.width,
        "height": depth.height,
        "valid": int(depth.valid.sum()),
        **range_facts(depth),
        "metadata": {**stored.metadata, **_exr_facts(stored)},
        "channel": stored.channel,
        "warnings": stored.warnings if stored.is_integer else with_scale,
    }


@dataclass(frozen=True, slots=True)
class PixelDepth:
    """Depth at a pixel, and in space where the camera is known."""

    depth: float | None  #: None without depth
    point_m: tuple[float, ...] | None = None  #: x right, y down, z along the camera axis
    normal: tuple[float, ...] | None = None  #: unit vector towards the camera
    error: float | None = None  #: expected, as a share of the depth; None if it is not known


def depth_at(depth: DepthMap, x: int, y: int) -> PixelDepth:
    """Depth at a column and a row; UsageError outside the map."""
    if x >= depth.width or y >= depth.height:
        raise UsageError(f"{x},{y} is outside the map of {depth.width}×{depth.height} pixels")
    if not depth.valid[y, x]:
        return PixelDepth(None)
    value, focal_px = float(depth.values[y, x]), _focal_px(depth)
    error = None if depth.error is None else float(depth.error[y, x])
    if focal_px is None:
        return PixelDepth(value, error=error)
    left, top = max(x - _REACH_PX, 0), max(y - _REACH_PX, 0)
    part = _cropped(depth, left, top, x + _REACH_PX + 1, y + _REACH_PX + 1)
    xyz_m = surface_of(part, focal_px).xyz_m
    point_m = xyz_m[y - top, x - left]
    near = xyz_m[np.abs(xyz_m[..., 2] - value) < _SAME_SURFACE * value]  # without NaN
    # Of a plane through the points: steps of a millimetre would tilt the normal of neighbours.
    normal = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2][-1]
    normal *= -np.sign(normal @ point_m) or 1
    return PixelDepth(value, (*map(float, point_m),), (*map(float, normal),), error)


QUANTILES = {"min": 0, "p05": 0.05, "p25": 0.25, "median": 0.5, "p75": 0.75, "p95": 0.95, "max": 1}
"""Shares of the pixels of an area that are nearer, by name."""


@dataclass(frozen=True, slots=True)
class AreaDepth:
    """Depth in a part of a map."""

    pixels: int  #: of the area
    without_depth: float  #: share of them
    quantiles: Mapping[str, float | None]  #: by the names of ``QUANTILES``; None without depth
    size_m: tuple[float, float] | None = None  #: width and height of a box at its median depth
    is_on_edge: bool = False  #: whether a box holds a near and a far surface
    error: float | None = None  #: median of those expected, as a share of the depth


def depth_in(depth: DepthMap, area: tuple[int, int, int, int] | BoolArray) -> AreaDepth:
    """Depth in a box (first column and row, and those after the last), or a mask (H, W) bool."""
    size, size_m, is_on_edge = f"the map of {depth.width}×{depth.height} pixels", None, False
    focal_px = _focal_px(depth)
    if isinstance(area, tuple):
        left, top, right, bottom = area
        if not (left < right <= depth.width and top < bottom <= depth.height):
            raise UsageError(f"{','.join(map(str, area))} is no box within {size}")
        mask: Any = np.s_[top:bottom, left:right]
    else:
        if area.shape != depth.values.shape:
            raise UsageError(f"a mask of {area.shape[1]}×{area.shape[0]} is not for {size}")
        if not area.any():
            raise UsageError("the mask has no pixel above 0")
        mask = area
    valid, values = depth.valid[mask], depth.values[mask]
    quantiles = np.quantile(values[valid], list(QUANTILES.values())) if valid.any() else ()
    named = dict.fromkeys(QUANTILES) | dict(zip(QUANTILES, map(float, quantiles), strict=False))
    if isinstance(area, tuple) and focal_px and (median_m := named["median"]):
        box = _cropped(depth, *area)
        width_m, height_m = (side * median_m / focal_px for side in (box.width, box.height))
        size_m = width_m, height_m / depth.provenance.pixel_aspect
        is_on_edge = holds_edge(np.where(box.valid, box.values, np.float32(np.nan)), focal_px)
    errors = () if depth.error is None else depth.error[mask][valid]
    error = float(np.median(errors)) if len(errors) else None
    return AreaDepth(valid.size, float(1 - valid.mean()), named, size_m, is_on_edge, error)


def _focal_px(depth: DepthMap) -> float | None:
    """The focal length of a metric map of a pinhole camera; None if there is none."""
    source = depth.provenance
    is_plane = depth.is_metric and not (source.is_cropped or source.projection.is_other)
    return source.focal_px if is_plane else None


def _cropped(depth: DepthMap, left: int, top: int, right: int, bottom: int) -> DepthMap:
    """A part of a map, with the same camera."""
    source = depth.provenance
    x, y = source.centre_px or ((depth.width - 1) / 2, (depth.height - 1) / 2)
    values = depth.values[top:bottom, left:right]
    return DepthMap(values, depth.kind, replace(source, centre_px=(x - left, y - top)))


def read_mask(file: str) -> BoolArray:
    """The pixels of an image that are above 0 in any channel, (H, W) bool."""
    pixels = read_image(file).pixels
    return np.asarray(pixels.reshape(*pixels.shape[:2], -1).any(axis=2), np.bool_)


def _exr_facts(stored: StoredDepth) -> dict[str, str]:
    """Facts for compositing in the header of an EXR, by the names of its attributes."""
    frame = stored.frame
    if stored.channel is None or frame.windows is None:
        return {}
    # The first and the last pixel, as the header has them.
    windows = {"dataWindow": frame.windows.data, "displayWindow": frame.windows.display}
    facts = {n: f"{w.left},{w.top} to {w.right - 1},{w.bottom - 1}" for n, w in windows.items()}
    facts["pixelAspectRatio"] = f"{frame.pixel_aspect:.6g}"
    if frame.rate is not None:
        facts["framesPerSecond"] = rate_text(frame.rate)
    if frame.time_code is not None:
        facts["timeCode"] = time_code_text(frame.time_code, frame.rate or FALLBACK_RATE)
    return facts


def _video_facts(video: DepthVideo) -> dict[str, object]:
    frames = valid = width = height = 0
    low, high, scale = math.inf, -math.inf, None
    for frames, stored in enumerate(video.frames(), start=1):  # noqa: B007 - the last number
        depth, scale = stored.depth, stored.scale
        valid_depth = depth.values[depth.valid]
        valid += valid_depth.size
        height, width = depth.values.shape
        low = min(low, float(valid_depth.min(initial=np.inf)))
        high = max(high, float(valid_depth.max(initial=-np.inf)))
    units, source = scale or (None, None)
    return {
        "kind": video.kind.value,
        "unit": None if video.scale is None else "m",
        "scale": units,
        "scale_source": source,
        "width": width,
        "height": height,
        "valid": valid,
        "min": low if valid else None,
        "max": high if valid else None,
        "metadata": video.labels,
        "frames": frames,
        "fps": None if video.rate is None else rate_text(video.rate),
    }
