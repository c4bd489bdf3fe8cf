"""Reading depth files, our own and those of other tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError
from depthcli.io.decode import read_bytes
from depthcli.io.png_text import read_text

if TYPE_CHECKING:
    from pathlib import Path

_MILLIMETRES = 1000.0
_CHANNELS = ("Z", "V", "Y", "R")
_DIMENSIONS = 2


def read_depth(path: Path, *, png_scale: float | None = None) -> DepthMap:
    """Depth of a 16-bit PNG, EXR or NPY file, chosen by its suffix.

    Args:
        path: the file.
        png_scale: steps per metre of a PNG; None for what the file says of itself, or millimetres.

    Returns:
        (H, W); NaN where there is no depth. Metric unless the file says otherwise.

    Raises:
        InputError: missing, damaged, or without depth.
    """
    readers = {".png": _png, ".exr": _exr, ".npy": _npy}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path} is not .png, .exr or .npy, so no depth is read from it")
    return _png(path, png_scale) if reader is _png else reader(path)


def _png(path: Path, png_scale: float | None = None) -> DepthMap:
    data = read_bytes(path)
    steps = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if steps is None:
        raise InputError(f"{path} is not a PNG that can be decoded")
    if steps.dtype != np.uint16 or steps.ndim != _DIMENSIONS:
        raise InputError(f"{path} is not 16-bit gray, so it holds no depth (a preview, perhaps?)")
    texts = read_text(data)
    kind = _kind(texts.get("depthcli:kind"))
    values = steps.astype(np.float32)
    if texts.get("depthcli:scale") == "normalized" and png_scale is None:
        low, high = (float(word) for word in texts["depthcli:range"].split())
        values = (low + (values - 1) / 65534 * (high - low)).astype(np.float32)
    else:
        scale = png_scale or _number(texts.get("depthcli:scale")) or _MILLIMETRES
        values /= np.float32(scale)
    return DepthMap(np.where(steps == 0, np.float32(np.nan), values), kind)


def _npy(path: Path) -> DepthMap:
    read_bytes(path)
    try:
        values = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise InputError(f"{path} is not a NumPy file that can be read") from error
    while values.ndim > _DIMENSIONS and 1 in values.shape:
        # Batch and channel axes, as networks' outputs have them; a map one pixel high stays.
        values = values.squeeze(values.shape.index(1))
    if values.ndim != _DIMENSIONS or values.dtype.kind not in "fiu":
        raise InputError(f"{path} is {values.shape} {values.dtype}; depth is one (H, W) of numbers")
    return DepthMap(np.ascontiguousarray(values, np.float32))


def _exr(path: Path) -> DepthMap:
    import OpenEXR  # noqa: PLC0415 - reading PNG need not wait for it

    read_bytes(path)
    try:
        file = OpenEXR.File(str(path), separate_channels=True)
        channels, header = file.channels(), file.header()
        name = depth_channel(list(channels))
        values = np.ascontiguousarray(channels[name].pixels, np.float32) if name else None
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(f"{path} is not an EXR file that can be read") from error
    if values is None:
        raise InputError(f"{path} has no channel Z, V, Y or R; it has {', '.join(channels)}")
    return DepthMap(values, _kind(header.get("depthcli:kind")))


def depth_channel(names: list[str]) -> str | None:
    """The channel that holds depth: Z, V, Y or R, bare first, else the last word of a layer."""
    for wanted in _CHANNELS:
        if wanted in names:
            return wanted
    for wanted in _CHANNELS:
        layered = sorted(name for name in names if name.rpartition(".")[2] == wanted)
        if layered:
            return layered[0]
    return None


def _kind(text: str | None) -> DepthKind:
    return DepthKind(text) if text in set(DepthKind) else DepthKind.METRIC


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if value > 0 else None
