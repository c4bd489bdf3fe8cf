"""Downsampling depth with holes; pixels without a measurement do not contribute."""

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

# One half, less a margin for rounding.
_LEAST_SHARE = 0.5 - 1e-5


class FilledDepth(NamedTuple):
    """Depth with its holes filled, and the mask of valid pixels."""

    #: (H, W) float32 metres; in a hole, that of the nearest pixel with a measurement
    depth_m: npt.NDArray[np.float32]
    valid_mask: (
        npt.NDArray[np.bool_] | None
    )  #: (H, W) bool, False in a hole; None if there is no hole


def downsample(depth_m: npt.NDArray[np.float32], size: tuple[int, int]) -> FilledDepth | None:
    """Downsample depth by the mean of the measured part of each new pixel's area.

    Takes (H, W) float32 metres, with 0, NaN or infinity in holes, and the new width and height in
    px. A new pixel is valid if at least half of its area is; returns None if no pixel is.
    """
    valid_mask = np.isfinite(depth_m) & (depth_m > 0)
    if valid_mask.all():
        return FilledDepth(_area(depth_m, size), None)
    share = _area(valid_mask.astype(np.float32), size)
    total_m = _area(np.where(valid_mask, depth_m, np.float32(0)), size)
    measured = share >= _LEAST_SHARE
    if not measured.any():
        return None
    mean_m = np.divide(total_m, share, out=total_m, where=measured)
    return FilledDepth(_nearest_valid(mean_m, measured), None if measured.all() else measured)


def _area(values: npt.NDArray[np.float32], size: tuple[int, int]) -> npt.NDArray[np.float32]:
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)


def _nearest_valid(
    depth_m: npt.NDArray[np.float32], valid_mask: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float32]:
    """Fill invalid pixels with the value of the nearest valid one."""
    if valid_mask.all():
        return depth_m
    _, labels = cv2.distanceTransformWithLabels(
        (~valid_mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    value_of = np.zeros(int(labels.max()) + 1, np.float32)
    value_of[labels[valid_mask]] = depth_m[valid_mask]
    return np.where(valid_mask, depth_m, value_of[labels])
