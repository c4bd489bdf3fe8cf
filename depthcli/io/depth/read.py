"""Reading depth files of depthcli and of other tools."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.metadata import kind_named, own_metadata, provenance_of
from depthcli.io.depth.quantization import denormalized, dequantized
from depthcli.io.depth.sidecar import with_sidecar
from depthcli.io.depth.stored import StepScale, StoredDepth, step_scale
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.images.decode import OPENCV_MAX_PIXELS, decode, image_size, read_bytes
from depthcli.io.images.png import read_text
from depthcli.io.storage.paths import path_of

_DIMENSIONS = 2
_FARTHEST = 1e12  # no depth is larger, in any unit


def read_stored_depth(
    path: str | Path,
    *,
    png_scale: float | None = None,
    kind: DepthKind | None = None,
    unstated_kind: DepthKind | None = None,
    unstated_scale: float | None = None,
) -> StoredDepth:
    """Depth of a 16-bit PNG, EXR or NPY file, chosen by its suffix.

    Args:
        path: the file.
        png_scale: units per metre of a PNG, None for what the file states, or millimetres; or of
            integers in an NPY file, which need it to be metric.
        kind: kind of the depth; None for what the file states, or metric.
        unstated_kind: as ``kind``, but only for a file that states none.
        unstated_scale: as ``png_scale``, but only for a file of integers that states none.

    Returns:
        (H, W); NaN where there is no depth. Its provenance is what the file or the sidecar beside
        it states of model, camera, anchors and orientation.

    Raises:
        InputError: missing, damaged, without depth, or metric integers without a scale.
        UsageError: a scale for an NPY file of floats, which are metres.
    """
    path = path_of(path)
    match path.suffix.lower():
        case ".png":
            stored = _png(path, png_scale, unstated_scale)
        case ".exr":
            # Reading PNG need not wait for OpenEXR.
            from depthcli.io.exr.depth import read_exr_depth  # noqa: PLC0415

            stored = read_exr_depth(path)
        case ".npy":
            stored = _npy(path, png_scale, kind, unstated_kind, unstated_scale)
        case _:
            raise InputError(
                f"{path} is not a depth file (.png, .exr, .npy, .mkv); "
                "'depthcli predict' and 'depthcli video' estimate the depth of pictures and videos"
            )
    if "kind" not in stored.metadata:
        kind = kind or unstated_kind
    return replace(stored, depth=replace(stored.depth, kind=kind or stored.depth.kind))


def read_metadata(path: Path) -> Mapping[str, str]:
    """Metadata of a depth file and its sidecar, texts by name; a PNG is not decoded for it.

    Raises:
        InputError: missing or damaged.
    """
    if path.suffix.lower() == ".png":
        return _png_metadata(path, read_bytes(path))[0]
    return read_stored_depth(path).metadata


def _png(path: Path, png_scale: float | None, unstated_scale: float | None) -> StoredDepth:
    data = read_bytes(path)
    steps = decode(data, str(path), max_pixels=OPENCV_MAX_PIXELS)
    if steps.dtype != np.uint16 or steps.ndim != _DIMENSIONS:
        raise InputError(
            f"{path} is not 16-bit gray, so it holds no depth; it may be a preview or a picture"
        )
    metadata, problems = _png_metadata(path, data)
    scale = step_scale(metadata, png_scale)
    if scale and scale.source == "assumed" and unstated_scale is not None:
        scale = StepScale(unstated_scale, "option")
    span = _normalized_range(metadata) if scale is None else None
    if span is None:
        values = dequantized(steps, scale.units_per_metre if scale else MILLIMETRES)
    else:
        values = denormalized(steps, *span)
    depth = DepthMap(values, kind_named(metadata.get("kind")), provenance_of(metadata))
    return StoredDepth(str(path), depth, metadata, scale, warnings=problems)


def _png_metadata(path: Path, data: bytes) -> tuple[dict[str, str], tuple[str, ...]]:
    return with_sidecar(path, own_metadata(read_text(data)), image_size(data) or (0, 0))


def _npy(
    path: Path,
    scale: float | None,
    kind: DepthKind | None,
    unstated_kind: DepthKind | None,
    unstated_scale: float | None,
) -> StoredDepth:
    values = _array(path)
    is_float = values.dtype.kind == "f"
    if is_float and scale is not None:
        raise UsageError(f"a scale is for integers, but {path} holds {values.dtype}; remove it")
    if not is_float and scale is None:
        scale = unstated_scale
    if scale is not None:
        depth = dequantized(values, scale)
    else:
        with np.errstate(over="ignore", invalid="ignore"):  # a double beyond float32 is no depth
            depth = np.ascontiguousarray(values, np.float32)
    height, width = depth.shape
    metadata, problems = with_sidecar(path, {}, (width, height), depth)
    if "kind" not in metadata:
        kind = kind or unstated_kind
    kind = kind or kind_named(metadata.get("kind"))
    if not is_float and scale is None and kind is DepthKind.METRIC:
        raise InputError(
            f"{path} holds {values.dtype}, not float metres; state its units per metre (info and "
            "probe: --png-scale, convert: --from-scale, predict and "
            "batch: --anchors-scale, eval: --predictions-scale), for millimetres for example "
            f"'depthcli convert {path} OUT.npy --from-scale 1000'"
        )
    stated = None if scale is None else StepScale(scale, "option")
    depth_map = DepthMap(depth, kind, provenance_of(metadata))
    return StoredDepth(str(path), depth_map, metadata, stated, warnings=problems)


def _array(path: Path) -> npt.NDArray[Any]:
    """The (H, W) numbers in an NPY file."""
    data = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the header is read as Python, which may warn
            values = np.lib.format.read_array(BytesIO(data), allow_pickle=False)
    except Exception as error:
        raise InputError(f"{path} is not a NumPy file that can be read") from error
    while values.ndim > _DIMENSIONS and 1 in values.shape:
        # Batch and channel axes, as networks' outputs have them; a map one pixel high stays.
        values = values.squeeze(values.shape.index(1))
    if values.ndim != _DIMENSIONS or values.dtype.kind not in "fiu" or not values.size:
        raise InputError(
            f"{path} holds {values.shape} {values.dtype}; depth is one (H, W) array of numbers"
        )
    return values


def _normalized_range(metadata: Mapping[str, str]) -> tuple[float, float] | None:
    """The values of 1 and 65535 in a normalized PNG of depthcli; None if it states none."""
    try:
        low, high = (float(word) for word in metadata.get("range", "").split())
    except ValueError:
        return None
    return (low, high) if -_FARTHEST < low <= high < _FARTHEST else None
