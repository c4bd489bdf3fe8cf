"""Plain numbers: NPY and NPZ of NumPy, PFM (stereo and MVS), TIFF, and the dense maps of COLMAP."""

import json
import math
import re
import warnings
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from depthcli.core.arrays import AnyArray
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, Message
from depthcli.io.images import tiff
from depthcli.io.images.read import OPENCV_MAX_PIXELS, check
from depthcli.io.storage.paths import read_bytes
from depthcli.io.stored.depth import METRIC, DepthReadOptions, StoredDepth
from depthcli.io.stored.metadata import ERROR, metadata_texts

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
        del frame
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
        del frame
        with path.open("wb") as file:
            arrays: dict[str, Any] = {"depth": depth.values}
            if depth.error is not None:
                arrays[ERROR] = depth.error
            np.savez(file, depthcli=json.dumps(metadata_texts(depth)), **arrays)
        return ()


def read(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of a gray file or of arrays of any program, in the format that its suffix names."""
    suffix, data, several = path.suffix.lower(), read_bytes(path), None
    if suffix in {".npy", ".npz"}:
        return _read_arrays(data, path, options)
    if suffix in {".pfm", ".bin"}:
        values = _plain_floats(data, path)
    else:
        image = check(data, str(path), OPENCV_MAX_PIXELS)
        values, several = image.decode().pixels, image.header.warning
        no_data = tiff.no_data_value(data)
        np.putmask(values, values == no_data, 0 if values.dtype.kind in "iu" else math.nan)
    if values.ndim != 2 or values.dtype == np.uint8:  # noqa: PLR2004
        raise InputError(f"{path} is an image, not gray of 16 bits or more, so it holds no depth")
    result = StoredDepth.of(path, values, {}, options)
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
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the header is read as Python, which may warn
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
