"""Depth with holes: pixels without a measurement neither count nor mix with those that have one."""

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

# Exactly half counts, and half in floats may be a little less.
_LEAST_SHARE = 0.5 - 1e-5


class Measured(NamedTuple):
    """Depth without holes, and where there was one."""

    #: (H, W) float32 metres; in a hole, that of the nearest pixel with a measurement
    depth_m: npt.NDArray[np.float32]
    known: npt.NDArray[np.bool_] | None  #: (H, W) bool, False in a hole; None if there is no hole


def shrink(depth_m: npt.NDArray[np.float32], size: tuple[int, int]) -> Measured | None:
    """Resize depth by the mean of what was measured in the area of each new pixel.

    Of (H, W) float32 metres, in which 0, NaN and infinity are holes, to a width and height in px. A
    new pixel is measured if half of its area is; None if no new pixel is.
    """
    known = np.isfinite(depth_m) & (depth_m > 0)
    if known.all():
        return Measured(_area(depth_m, size), None)
    share = _area(known.astype(np.float32), size)
    total_m = _area(np.where(known, depth_m, np.float32(0)), size)
    measured = share >= _LEAST_SHARE
    if not measured.any():
        return None
    mean_m = np.divide(total_m, share, out=total_m, where=measured)
    return Measured(_nearest_known(mean_m, measured), None if measured.all() else measured)


def _area(values: npt.NDArray[np.float32], size: tuple[int, int]) -> npt.NDArray[np.float32]:
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)


def _nearest_known(
    depth_m: npt.NDArray[np.float32], known: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float32]:
    """The value of the nearest known pixel everywhere else."""
    if known.all():
        return depth_m
    _, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    value_of = np.zeros(int(labels.max()) + 1, np.float32)
    value_of[labels[known]] = depth_m[known]
    return np.where(known, depth_m, value_of[labels])
