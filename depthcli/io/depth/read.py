"""Reading depth files of depthcli and of other tools."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np

from depthcli.core.overscan import displayed_depth
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.metadata import (
    kind_named,
    positive_number,
    provenance_of,
    sidecar_metadata,
    with_sidecar,
)
from depthcli.io.depth.quantization import UINT16_MAX, dequantized
from depthcli.io.pictures.decode import decode, read_bytes
from depthcli.io.png.chunks import read_text
from depthcli.io.storage.remote import path_of
from depthcli.io.writers.formats import MILLIMETRES

_DIMENSIONS = 2
_FARTHEST = 1e12  # no depth is larger, in any unit


def read_depth(
    path: str | Path, *, png_scale: float | None = None, kind: DepthKind | None = None
) -> DepthMap:
    """Depth of a 16-bit PNG, EXR or NPY file, chosen by its suffix.

    Args:
        path: the file.
        png_scale: steps per metre of a PNG, None for what the file states, or millimetres; or of
            integers in an NPY file, which need it to be metric.
        kind: kind of the depth; None for what the file states, or metric.

    Returns:
        (H, W), of an EXR its display window; NaN where there is no depth. Its provenance is what
        the file or the sidecar beside it states of model, focal length and orientation.

    Raises:
        InputError: missing, damaged, without depth, or metric integers without a scale.
        UsageError: a scale for an NPY file of floats, which are metres.
    """
    depth, frame = read_whole_depth(path, png_scale=png_scale, kind=kind)
    return displayed_depth(depth, frame.windows)


def read_whole_depth(
    path: str | Path, *, png_scale: float | None = None, kind: DepthKind | None = None
) -> tuple[DepthMap, Frame]:
    """What :func:`read_depth` returns, of an EXR with the pixels outside its display window.

    Returns:
        The map, of an EXR over its data window, and a frame without a picture that has the windows,
        the shape of pixels and the rate that the file states.
    """
    path, frame = path_of(path), Frame(np.zeros((1, 1), np.uint8))
    match path.suffix.lower():
        case ".png":
            depth = _png(path, png_scale)
        case ".exr":
            depth, frame = _exr_depth(path)
        case ".npy":
            depth = _npy(path, png_scale, kind)
        case _:
            raise InputError(
                f"{path} is not a depth file (.png, .exr, .npy, .mkv); "
                "'depthcli predict' and 'depthcli video' estimate the depth of pictures and videos"
            )
    return replace(depth, kind=kind or depth.kind), frame


def channel_read(path: Path) -> str | None:
    """The channel of an EXR that its depth is read from; None for other files.

    Raises:
        InputError: missing or damaged.
    """
    if path.suffix.lower() != ".exr":
        return None
    # Reading PNG need not wait for OpenEXR.
    from depthcli.io.depth.exr_map import read_depth_channel  # noqa: PLC0415

    return read_depth_channel(path)


def _png(path: Path, png_scale: float | None) -> DepthMap:
    data = read_bytes(path)
    steps = decode(data, str(path))
    if steps.dtype != np.uint16 or steps.ndim != _DIMENSIONS:
        raise InputError(
            f"{path} is not 16-bit gray, so it holds no depth; it may be a preview or a picture"
        )
    metadata = with_sidecar(path, read_text(data))
    span = _normalized_range(metadata) if png_scale is None else None
    if span is None:
        depth = dequantized(
            steps, png_scale or positive_number(metadata.get("scale")) or MILLIMETRES
        )
    else:
        low, high = span
        share = (steps.astype(np.float64) - 1) / (UINT16_MAX - 1)
        values = (low + share * (high - low)).astype(np.float32)
        depth = np.where(steps == 0, np.float32(np.nan), values)
    return DepthMap(depth, kind_named(metadata.get("kind")), provenance_of(metadata))


def _npy(path: Path, scale: float | None, kind: DepthKind | None) -> DepthMap:
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
    # The format cannot state its kind itself.
    kind = kind or kind_named(str(sidecar_metadata(path).get("kind")))
    is_float = values.dtype.kind == "f"
    if is_float and scale is not None:
        raise UsageError(f"a scale is for integers, but {path} holds {values.dtype}; remove it")
    if not is_float and scale is None and kind is DepthKind.METRIC:
        raise InputError(
            f"{path} holds {values.dtype}, not float metres; state its units per metre (info and "
            "probe: --png-scale, convert: --from-scale, predict and "
            "batch: --anchors-scale), for millimetres for example "
            f"'depthcli convert {path} OUT.npy --from-scale 1000'"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # a double beyond float32 is infinitely far
        depth = np.ascontiguousarray(values, np.float32)
    if scale is not None:
        depth = dequantized(values, scale)
    return DepthMap(depth, kind, provenance_of(with_sidecar(path, {})))


def _exr_depth(path: Path) -> tuple[DepthMap, Frame]:
    # Reading PNG need not wait for OpenEXR.
    from depthcli.io.depth.exr_map import read_exr_depth  # noqa: PLC0415

    return read_exr_depth(path)


def _normalized_range(metadata: Mapping[str, str]) -> tuple[float, float] | None:
    """The values of 1 and 65535 in a normalized PNG of depthcli; None for other files."""
    if metadata.get("scale") != "normalized":
        return None
    try:
        low, high = (float(word) for word in metadata.get("range", "").split())
    except ValueError:
        return None
    return (low, high) if -_FARTHEST < low <= high < _FARTHEST else None
