"""Depth as numbers: integers in PNG and PGM, floats in other files, and the sidecar in JSON.

16-bit gray is by default in millimetres, and 0 means no depth. Floats are in NPY and NPZ of NumPy,
PFM (stereo and MVS), TIFF, and the dense maps of COLMAP.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import cv2
import numpy as np

from depthcli.core.imageops import row_bands
from depthcli.core.options import one_line
from depthcli.core.types import AnyArray, DepthKind, DepthMap, DepthRange, Frame, UInt16Array
from depthcli.errors import InputError, Message, OutputError
from depthcli.io.formats.table import WriterOptions
from depthcli.io.images import png, tiff
from depthcli.io.images.read import OPENCV_MAX_PIXELS, check
from depthcli.io.media import KEY_PREFIX
from depthcli.io.storage.paths import read_bytes
from depthcli.io.stored import metadata as facts
from depthcli.io.stored.depth import (
    METRIC,
    SIDECAR_ENDS,
    DepthReadOptions,
    StoredDepth,
    reciprocal,
    with_sidecar,
)
from depthcli.io.stored.metadata import ERROR, metadata_texts

_ERROR_STEPS = 10_000.0
_PGM_TEXT = re.compile(rb"^# (%s\w+) (.*)$" % KEY_PREFIX.encode(), re.MULTILINE)
_PGM_HEAD_BYTES = 4096


class Png16Writer(WriterOptions):
    """uint16 gray PNG, or PGM (Netpbm) by the suffix of the file."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write (H, W) uint16; depth beyond the range saturates, with a warning."""
        steps, texts, warnings = stored_steps(depth, self, path.suffix[1:])
        if path.suffix.lower() != ".pgm":
            path.write_bytes(png.encode_png(steps, facts.own_texts(texts)))
            return warnings
        comments = [one_line(f"# {name} {text}") for name, text in facts.own_texts(texts).items()]
        lines = ["P5", *comments, f"{depth.width} {depth.height}", "65535", ""]
        head = "\n".join(lines).encode("ascii", "backslashreplace")
        path.write_bytes(head + steps.astype(">u2").tobytes())
        return warnings


class ErrorWriter(WriterOptions):
    """The expected error of depth in steps of 0.01 % of it; 0 where there is no depth."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write (H, W) uint16."""
        if depth.error is None:
            raise OutputError("the error of depth is not known", "leave it out", option="format")
        error = np.where(depth.valid, depth.error, np.float32(np.nan))
        steps, _ = facts.quantized(error, _ERROR_STEPS)
        texts = metadata_texts(depth) | {"kind": ERROR, "scale": f"{_ERROR_STEPS:g}"}
        path.write_bytes(png.encode_png(steps, facts.own_texts(texts)))
        return ()


class SidecarWriter(WriterOptions):
    """Unit, scale, kind, orientation, model, resize, camera, range and version."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one JSON object."""
        source = depth.provenance
        range_, ends = DepthRange.of(depth), dict[str, float]()
        if self.is_normalized and range_.min is not None and range_.max is not None:
            ends = dict(zip(SIDECAR_ENDS, self.range_of((range_.min, range_.max)), strict=True))
        has_unit = depth.is_metric and not self.is_normalized
        document = {
            "software": facts.SOFTWARE,
            "kind": depth.kind.value,
            "unit": depth.unit,
            "png16_scale": self.units_per_metre if has_unit else None,
            **({"png16_inverse": True} if self.png_inverse and depth.is_metric else {}),
            **ends,
            "width": depth.width,
            "height": depth.height,
            "orientation": frame.orientation if frame else source.orientation,
            **({"projection": source.projection} if source.projection.is_other else {}),
            **({} if source.time_s is None else {"time_s": source.time_s}),
            **range_._asdict(),
            "network_size_px": source.input_size_px,
            **facts.origin_fields(depth),
            **facts.known_depth_fields(depth),
        }
        path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", "utf-8")
        return ()


def stored_steps(
    depth: DepthMap, options: Png16Writer, suffix: str
) -> tuple[UInt16Array, dict[str, str], tuple[str, ...]]:
    """The integers of a map, (H, W) uint16; texts that say what they mean; and warnings."""
    texts, is_metric = metadata_texts(depth), depth.is_metric
    if not options.is_normalized and is_metric:
        steps, saturated = facts.quantized(depth.values, options.units_per_metre)
        texts |= {
            "scale": f"{options.units_per_metre:g}",
            "unit": facts.step_unit(options.units_per_metre),
        }
        limit_m = facts.UINT16_MAX / options.units_per_metre
        warning = f"{saturated} pixels beyond {limit_m:.6g} m were saturated"
        return steps, texts, (warning,) if saturated else ()
    scale = "normalized"
    if options.png_inverse and is_metric:
        least, most = options.vmin, options.vmax
        if any(end is not None and end <= 0 for end in (least, most)):
            raise OutputError("0 m has no inverse", "give {vmin} and {vmax} above 0")
        scale, depth = "inverse", replace(depth, values=reciprocal(depth.values))
        options = replace(options, vmin=most and 1 / most, vmax=least and 1 / least)
    steps, (low, high), saturated = stretched(depth, options)
    texts |= {"scale": scale, "range": f"{low:.9g} {high:.9g}"}
    warning = f"{depth.kind} depth has no unit; {suffix} is normalized"
    if options.png_inverse and depth.kind is DepthKind.RELATIVE:
        warning += ", and far is white, as it has no inverse"
    warnings = (warning,) * (not (is_metric or options.png_normalize))
    if saturated:
        ends = (1 / high, 1 / low) if scale == "inverse" else (low, high)
        beyond = f"outside {ends[0]:.6g} to {ends[1]:.6g}{' m' if is_metric else ''}"
        warnings += (f"{saturated} pixels {beyond} were saturated",)
    return steps, texts, warnings


def stretched(
    depth: DepthMap, options: WriterOptions
) -> tuple[UInt16Array, tuple[float, float], int]:
    """Depth as 1-65535, 0 for none, (H, W) uint16, of its own range where no other is stated.

    Also returns the values that 1 and 65535 stand for, and the number of pixels beyond.
    """
    values, valid = depth.values, depth.valid
    if not valid.any():
        return np.zeros(values.shape, np.uint16), (0.0, 0.0), 0
    least = float(values.min(where=valid, initial=np.inf))
    most = float(values.max(where=valid, initial=-np.inf))
    low, high = options.range_of((least, most))
    half_step, saturated = (high - low) / (facts.UINT16_MAX - 1) / 2, 0
    steps = np.empty(values.shape, np.uint16)
    for rows in row_bands(values.shape[1], values.shape[0]):  # float64 of a whole map is large
        band = values[rows].astype(np.float64)
        steps[rows] = facts.normalized(band, valid[rows], low, high)
        beyond = (band < low - half_step) | (band > high + half_step)
        saturated += int(np.count_nonzero(valid[rows] & beyond))
    return steps, (low, high), saturated


def read_metadata(path: Path) -> Mapping[str, str]:
    """Metadata of a PNG and its sidecar, texts by name; the pixels are not decoded."""
    data = read_bytes(path)
    header = check(data, str(path), OPENCV_MAX_PIXELS).header
    return with_sidecar(path, _own_texts(data), (header.width, header.height))[0]


def _own_texts(data: bytes) -> dict[str, str]:
    if data.startswith(png.SIGNATURE):
        return facts.own_metadata(png.read_text(data))
    comments = _PGM_TEXT.findall(data[:_PGM_HEAD_BYTES])
    texts = {name.decode(): text.decode("ascii", "replace") for name, text in comments}
    return facts.own_metadata(texts)


_PFM = re.compile(rb"Pf\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]+)(?:\r\n|\s)")
COLMAP_MAP = re.compile(rb"(\d{1,9})&(\d{1,9})&\d{1,9}&")
_COLMAP_DEPTH = re.compile(rb"(\d{1,9})&(\d{1,9})&0*1&")
_TIFF_UNCOMPRESSED = 1
_DIMENSIONS, _RGB = 2, 3
_INTRINSICS = "intrinsics"
_NAMES = ("depth", "depths", "depth_m", "metric_depth", "depth_map", "pred", "prediction", "arr_0")
"""Names of the array with depth in an NPZ: Depth Pro, Depth Anything 3, Video Depth Anything."""


@dataclass(frozen=True, slots=True)
class FloatWriter:
    """NPY, PFM, uncompressed TIFF or COLMAP's dense map, by the suffix of the file."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write (H, W) float32 as it is; no depth is infinite in PFM, 0 in COLMAP's maps.

        The formats have no room for what the numbers mean, which is a warning if they have no unit.
        """
        suffix, values = path.suffix.lower(), np.ascontiguousarray(depth.values, "<f4")
        if suffix == ".npy":
            np.save(file := BytesIO(), values)  # which reports no error of a full disk
            data = file.getvalue()
        elif suffix == ".pfm":  # rows from the bottom
            pfm_values = np.where(np.isnan(values), np.float32(np.inf), values)
            data = f"Pf\n{depth.width} {depth.height}\n-1.0\n".encode() + pfm_values[::-1].tobytes()
        elif suffix == ".bin":
            data = f"{depth.width}&{depth.height}&1&".encode()
            data += np.nan_to_num(values, posinf=0).tobytes()
        else:
            settings = [cv2.IMWRITE_TIFF_COMPRESSION, _TIFF_UNCOMPRESSED]
            data = cv2.imencode(".tiff", values, settings)[1].tobytes()
        path.write_bytes(data)
        problem = f"{depth.kind} depth has no unit, which {suffix[1:]} cannot say"
        return () if depth.is_metric else (Message(problem, "{sidecar} does"),)


@dataclass(frozen=True, slots=True)
class NpzWriter:
    """``depth``, (H, W) float32, and ``depthcli``, its metadata as JSON."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the values unchanged."""
        with path.open("wb") as file:
            arrays: dict[str, Any] = {"depth": depth.values}
            if depth.error is not None:
                arrays[ERROR] = depth.error
            np.savez(file, depthcli=json.dumps(metadata_texts(depth)), **arrays)
        return ()


def read(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of a gray file or of arrays of any program, in the format that its suffix names."""
    suffix, data = path.suffix.lower(), read_bytes(path)
    texts, several = dict[str, str](), None
    if suffix in {".npy", ".npz"}:
        return _read_arrays(data, path, options)
    if suffix in {".pfm", ".bin"}:
        values = _plain_floats(data, path)
    else:
        image = check(data, str(path), OPENCV_MAX_PIXELS)
        values, several, texts = image.decode().pixels, image.header.warning, _own_texts(data)
        no_data = tiff.no_data_value(data)
        np.putmask(values, values == no_data, 0 if values.dtype.kind in "iu" else math.nan)
    if values.ndim != 2 or values.dtype == np.uint8:  # noqa: PLR2004
        raise InputError(f"{path} is an image, not gray of 16 bits or more, so it holds no depth")
    result = StoredDepth.of(path, values, texts, options)
    if several:  # pages of a TIFF
        result = replace(result, warnings=(*result.warnings, f"{path} {several}"))
    if suffix != ".bin" or result.scale is None or result.scale.source != "assumed":
        return result
    unit = Message("COLMAP's unit is arbitrary, and it is taken for metres", "state its scale")
    return replace(result, warnings=(*result.warnings, unit))


def _plain_floats(data: bytes, path: Path) -> AnyArray:
    """The pixels of a PFM, whose scale (Middlebury's is 1/255) OpenCV would multiply, or COLMAP."""
    is_pfm = path.suffix.lower() == ".pfm"
    head = (_PFM if is_pfm else _COLMAP_DEPTH).match(data)
    if head is None:
        kind = "gray portable float map" if is_pfm else "dense map of COLMAP of one channel"
        raise InputError(f"{path} is not a {kind}, so it holds no depth")
    width, height = int(head[1]), int(head[2])
    if not width or not height or len(data) - head.end() < 4 * width * height:
        raise InputError(f"{path} is truncated or damaged", "copy it again")
    order = ">f4" if is_pfm and not head[3].startswith(b"-") else "<f4"
    values = np.frombuffer(data, order, width * height, head.end()).reshape(height, width)
    return values[::-1] if is_pfm else values


def _read_arrays(data: bytes, path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of one array of floats, or of integers of a known scale."""
    texts, name, others = dict[str, str](), "", dict[str, AnyArray]()
    try:
        with catch_warnings(action="ignore"):  # the header is read as Python, which may warn
            if path.suffix.lower() == ".npz":
                name, values, texts, others = _named_array(data)
            else:
                values = np.lib.format.read_array(BytesIO(data), allow_pickle=False)
    except Exception as error:
        raise InputError(f"{path} is not a NumPy file that can be read") from error
    options = options.for_name(name)
    values = _map_of(values, path, options.frame)
    cameras = others.get(_INTRINSICS, np.empty(0))
    texts = texts or _camera_texts(cameras, options.frame or 0, values.shape[1])
    is_bare = options.scale is None and options.unstated_scale is None
    if is_bare and options.kind not in {None, *METRIC}:
        values = np.asarray(values, np.float32)  # 0 is a value if there is no unit
    result = StoredDepth.of(path, values, texts, options)
    if result.is_integer and result.scale and result.scale.source == "assumed":
        advice = "state its units per metre, 1000 for millimetres"
        raise InputError(f"{path} holds {values.dtype}, not float metres", advice)
    if ERROR in others and texts:
        depth = replace(result.depth, error=np.asarray(others[ERROR], np.float32))
        return replace(result, depth=depth)
    return result


def _named_array(data: bytes) -> tuple[str, AnyArray, dict[str, str], dict[str, AnyArray]]:
    """Name and values of an NPZ's array with depth, metadata of depthcli, and other arrays."""
    with np.load(BytesIO(data), allow_pickle=False) as arrays:
        texts = json.loads(str(arrays["depthcli"])) if "depthcli" in arrays else {}
        names = [name for name in arrays.files if name != "depthcli"]
        name = next((name for name in _NAMES if name in names), names[0] if len(names) == 1 else "")
        texts = {str(key): str(text) for key, text in texts.items()}
        others = {key: arrays[key] for key in (_INTRINSICS, ERROR) if key in arrays}
        return name, np.asarray(arrays[name]), texts, others


def _camera_texts(matrices: AnyArray, frame: int, width: int) -> dict[str, str]:
    """Metadata of intrinsics in pixels of a map, (N, 3, 3) or (3, 3), as of Depth Anything 3."""
    matrix = matrices.reshape(-1, 3, 3)[frame : frame + 1] if matrices.shape[-2:] == (3, 3) else ()
    for (fx, _, x), (_, fy, y), _ in matrix:
        if fx > 0 and 1 < x < width:  # others are in widths of the map
            centre = f"{x:.9g},{y:.9g}"
            return {"focal_px": f"{fx:.9g}", "centre_px": centre, "pixel_aspect": f"{fy / fx:.6g}"}
    return {}


def _map_of(values: AnyArray, path: Path, frame: int | None) -> AnyArray:
    """The (H, W) numbers of an array, or of one of several maps in it."""
    while values.ndim > _DIMENSIONS and 1 in values.shape:
        # Batch and channel axes, as networks' outputs have them; a map one pixel high stays.
        values = values.squeeze(values.shape.index(1))
    is_rgb = values.ndim == _DIMENSIONS + 1 and values.shape[2] == _RGB < len(values)
    if is_rgb and all(np.array_equal(values[..., 0], values[..., i], True) for i in (1, 2)):
        values = values[..., 0]  # of a gray image
    if values.ndim == _DIMENSIONS + 1 and not is_rgb:  # of a video, or of several views
        if frame is None or frame >= len(values):
            problem = f"{path} holds {len(values)} maps"
            raise InputError(problem, "name one with {frame}, 0 for the first")
        values = values[frame]
    if values.ndim != _DIMENSIONS or values.dtype.kind not in "fiu" or not values.size:
        raise InputError(
            f"{path} holds {values.shape} {values.dtype}; depth is one (H, W) array of numbers"
        )
    return values
