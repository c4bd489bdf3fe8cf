"""Reading one picture or one depth image of a data set, with clear errors."""

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.errors import DatasetError, InputError
from depthcli.io.images.decode import MAX_FILE_BYTES, check, decoded
from depthcli.io.images.png import SIGNATURE
from depthcli.io.storage.regular import read_regular

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
DEPTH_SUFFIXES = (".png",)

_PNG_GRAY = 0
_PNG_DEPTH_BITS = 16


def depth_shape(path: Path) -> tuple[int, int]:
    """(rows, columns) of a 16-bit gray PNG, from its header.

    Raises:
        DatasetError: it is missing, not a PNG, has 8 bits, or has colour.
    """
    try:
        head = read_regular(path, MAX_FILE_BYTES, first=26)
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error.strerror}") from error
    if len(head) < 26 or not head.startswith(SIGNATURE):  # noqa: PLR2004
        raise DatasetError(f"{path} is not a PNG: depth is stored as 16-bit gray PNG")
    width, height, bits, colour = struct.unpack(">IIBB", head[16:26])
    if bits != _PNG_DEPTH_BITS or colour != _PNG_GRAY:
        kind = "gray" if colour == _PNG_GRAY else "colour"
        raise DatasetError(
            f"{path} is {bits}-bit {kind}: depth is stored as 16-bit gray PNG in millimetres"
        )
    return height, width


def read_depth_m(path: Path, units_per_metre: float) -> npt.NDArray[np.float32]:
    """Depth of a 16-bit gray PNG: (H, W) float32 metres, 0 where there is none.

    Raises:
        DatasetError: the file is missing, truncated, or of another format.
    """
    depth_shape(path)
    stored = _decode(path, cv2.IMREAD_UNCHANGED)
    # Division in float64 gives the float32 nearest to 2.718 for 2718 mm.
    depth_m: npt.NDArray[np.float32] = (stored / units_per_metre).astype(np.float32)
    return depth_m


def read_image_rgb(path: Path) -> npt.NDArray[np.uint8]:
    """Pixels of a picture: (H, W, 3) RGB uint8.

    Raises:
        DatasetError: the file is missing, truncated, or not a picture.
    """
    pixels = cv2.cvtColor(_decode(path, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    return pixels.astype(np.uint8, copy=False)


def _decode(path: Path, flags: int) -> npt.NDArray[np.integer]:
    try:
        data = read_regular(path, MAX_FILE_BYTES)
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error.strerror}") from error
    try:
        check(data, str(path))
        pixels = decoded(data, flags)
    except InputError as error:
        raise DatasetError(f"{path} cannot be decoded: {error}") from error
    except cv2.error:
        pixels = None
    if pixels is None:
        raise DatasetError(f"{path} cannot be decoded: it is damaged; copy it again")
    return np.asarray(pixels)


class PlausibleDepth(NamedTuple):
    """Range of the median depth of a data set, outside which its unit is wrong."""

    low_m: float
    high_m: float
    advice: str  #: what to do about another unit


def check_plausible(
    medians_m: Iterable[float], plausible: PlausibleDepth, where: Path | str
) -> None:
    """Check the unit of a data set's depth, by the medians of some images.

    Raises:
        DatasetError: the median of the medians is outside the range.
    """
    typical_m = float(np.median(list(medians_m)))
    low_m, high_m, advice = plausible
    if not low_m <= typical_m <= high_m:
        raise DatasetError(
            f"{where} has a median depth of {typical_m:.3g} m, outside {low_m:g}-{high_m:g} m: "
            f"check the unit, which {advice}"
        )


def median_m(depth_m: npt.NDArray[np.float32]) -> float:
    """Median of the positive depths, 0 if there are none."""
    positive = depth_m[depth_m > 0]
    return float(np.median(positive)) if positive.size else 0.0


def sample_positions(count: int, at_most: int = 9) -> list[int]:
    """At most ``at_most`` positions of samples, evenly spaced over ``range(count)``."""
    positions = np.linspace(0, count - 1, min(count, at_most)).astype(int)
    return [int(i) for i in np.unique(positions)]
