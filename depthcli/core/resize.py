"""Resizing with half-pixel centres, the same in training, inference and evaluation."""

import cv2
import numpy as np
import numpy.typing as npt


def resize_bilinear(
    values: npt.NDArray[np.float32], width: int, height: int
) -> npt.NDArray[np.float32]:
    """Bilinear, half-pixel centres, edges repeated, no antialiasing: how depth is resized.

    From (H, W) or (H, W, C) float32 to (height, width) or (height, width, C); a copy only if the
    size changes.
    """
    if values.shape[:2] == (height, width):
        return values
    return np.asarray(cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR))


def resize_rows(
    values: npt.NDArray[np.float32], width: int, height: int, rows: slice
) -> npt.NDArray[np.float32]:
    """Some rows of what :func:`resize_bilinear` returns, up to rounding, without the others.

    ``values`` are (H, W) float32; ``height`` is that of the whole result. Never a view of them.
    """
    last = values.shape[0] - 1
    numbers = np.arange(rows.start, rows.stop, dtype=np.float64)
    place = np.clip((numbers + 0.5) * (values.shape[0] / height) - 0.5, 0, last)
    above = place.astype(np.intp)
    share = (place - above).astype(np.float32)[:, np.newaxis]
    upper = values[above]
    mixed = upper + share * (values[np.minimum(above + 1, last)] - upper)
    return resize_bilinear(mixed, width, mixed.shape[0])


def resize_area(
    values: npt.NDArray[np.float32], width: int, height: int
) -> npt.NDArray[np.float32]:
    """Mean over each output pixel's area where it shrinks, bilinear where it grows: pictures.

    Shapes and types as of :func:`resize_bilinear`.
    """
    if values.shape[:2] == (height, width):
        return values
    rows, columns = values.shape[:2]
    if width <= columns and height <= rows:
        return np.asarray(cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA))
    # OpenCV's area method repeats pixels where it grows, so such an axis is stretched on its own.
    shrunk = (min(width, columns), min(height, rows))
    return resize_bilinear(resize_area(values, *shrunk), width, height)


def resize_cubic(
    values: npt.NDArray[np.float32], width: int, height: int
) -> npt.NDArray[np.float32]:
    """Bicubic, half-pixel centres, edges repeated, no antialiasing; it may overshoot.

    Shapes and types as of :func:`resize_bilinear`.
    """
    if values.shape[:2] == (height, width):
        return values
    return np.asarray(cv2.resize(values, (width, height), interpolation=cv2.INTER_CUBIC))
