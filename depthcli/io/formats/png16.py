"""16-bit PNG, by default in millimetres; 0 means no depth."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import row_bands
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError
from depthcli.io.depth.metadata import metadata_texts, own_metadata, own_texts, step_unit
from depthcli.io.depth.read import DepthReadOptions, StoredDepth
from depthcli.io.depth.scale import (
    UINT16_MAX,
    denormalized,
    dequantized,
    normalized,
    quantized,
)
from depthcli.io.formats.sidecar import FileMetadata, with_sidecar
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.images.png import encode_png, read_text
from depthcli.io.images.read import OPENCV_MAX_PIXELS, decode, image_size
from depthcli.io.storage.paths import read_bytes

_GRAY_RANK = 2
_FARTHEST = 1e12  # no depth is larger, in any unit


class Png16Writer(NamedTuple):
    """uint16 gray PNG."""

    #: units per metre: 1000 (NYU, ScanNet), 256 (KITTI), 5000 (TUM), 4000 (Matterport)
    png_scale: float = MILLIMETRES
    png_normalize: bool = False  #: normalize each map to 1-65535 instead, without a unit

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write (H, W) uint16; depth beyond the range saturates, with a warning."""
        del frame
        texts = metadata_texts(depth)
        warnings: tuple[str, ...] = ()
        if self.png_normalize or not depth.is_metric:
            steps, low, high = stretched(depth)
            texts |= {"scale": "normalized", "range": f"{low:.9g} {high:.9g}"}
            if not self.png_normalize:
                warnings = (f"{depth.kind} depth has no unit; {path.suffix[1:]} is normalized",)
        else:
            steps, saturated = quantized(depth.values, self.png_scale)
            texts |= {"scale": f"{self.png_scale:g}", "unit": step_unit(self.png_scale)}
            if saturated:
                limit_m = UINT16_MAX / self.png_scale
                warnings = (f"{saturated} pixels beyond {limit_m:.6g} m were saturated",)
        path.write_bytes(encode_png(steps, own_texts(texts)))
        return warnings


def stretched(depth: DepthMap) -> tuple[npt.NDArray[np.uint16], float, float]:
    """Depth scaled linearly to 1-65535; 0 where there is none.

    Returns:
        (H, W) uint16, and the values that 1 and 65535 stand for.
    """
    values, known = depth.values, depth.valid
    if not known.any():
        return np.zeros(values.shape, np.uint16), 0.0, 0.0
    low = float(values.min(where=known, initial=np.inf))
    high = float(values.max(where=known, initial=-np.inf))
    steps = np.empty(values.shape, np.uint16)
    for rows in row_bands(values.shape[1], values.shape[0]):  # float64 of a whole map is large
        steps[rows] = normalized(values[rows].astype(np.float64), known[rows], low, high)
    return steps, low, high


def read(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of a 16-bit gray PNG of any program.

    Raises:
        InputError: it cannot be read, or is not 16-bit gray.
    """
    data = read_bytes(path)
    steps = decode(data, str(path), max_pixels=OPENCV_MAX_PIXELS)
    if steps.dtype != np.uint16 or steps.ndim != _GRAY_RANK:
        raise InputError(
            f"{path} is not 16-bit gray, so it holds no depth; it may be a preview or a picture"
        )
    metadata = _metadata(path, data)
    if options.scale is None and metadata.texts.get("scale") == "normalized":
        span = _normalized_range(metadata.texts)
        values = dequantized(steps, MILLIMETRES) if span is None else denormalized(steps, *span)
        return StoredDepth.of(path, values, metadata, options)
    return StoredDepth.of(path, steps, metadata, options)


def read_metadata(path: Path) -> Mapping[str, str]:
    """Metadata of a PNG and its sidecar, texts by name; the pixels are not decoded.

    Raises:
        InputError: it cannot be read.
    """
    return _metadata(path, read_bytes(path)).texts


def _metadata(path: Path, data: bytes) -> FileMetadata:
    return with_sidecar(path, own_metadata(read_text(data)), image_size(data) or (0, 0))


def _normalized_range(metadata: Mapping[str, str]) -> tuple[float, float] | None:
    """The values of 1 and 65535 in a normalized PNG of depthcli; None if it states none."""
    try:
        low, high = (float(word) for word in metadata.get("range", "").split())
    except ValueError:
        return None
    return (low, high) if -_FARTHEST < low <= high < _FARTHEST else None
