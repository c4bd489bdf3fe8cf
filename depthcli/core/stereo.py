"""The views of two eyes from an image and its disparity."""

import cv2
import numpy as np
import numpy.typing as npt

_EDGE_SHARE = 1 / 128  # of the width: as wide is a smeared edge of depth
_LEAST_EDGE_PX = 2.0  # of disparity
_LEVELS = 2**15


def eye_view(
    rgb: npt.NDArray[np.uint8], shift_px: npt.NDArray[np.float32], nearness: npt.NDArray[np.float32]
) -> npt.NDArray[np.uint8]:
    """An image whose pixels are moved to the right; the nearest one hides others.

    Gaps, which the other eye does not see, are filled with the mirrored surface behind.

    Args:
        rgb: (H, W, 3) uint8.
        shift_px: (H, W) float32, finite.
        nearness: (H, W) float32 in [0, 1], 1 at the nearest pixel.
    """
    height, width = shift_px.shape
    columns, rows = np.arange(width), np.arange(height)[:, np.newaxis]
    target = np.rint(columns + shift_px).astype(np.int64)
    inside = (target >= 0) & (target < width)
    # The nearest source of each target: its nearness and its column in one number.
    keys = np.rint(nearness * _LEVELS).astype(np.int64) * width + columns
    best = np.full(height * width, -1, np.int64)
    np.maximum.at(best, (rows * width + target)[inside], keys[inside])
    best = best.reshape(height, width)
    source = best % width
    # Between pixels, as the target of a source is no whole column.
    place = source + columns - (source + np.take_along_axis(shift_px, source, 1))
    _fill_gaps(place, best)
    maps = place.astype(np.float32), np.broadcast_to(rows, place.shape).astype(np.float32)
    return np.asarray(
        cv2.remap(rgb, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def sharpened(disparity_px: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Disparity without ramps at edges, which would be drawn out: each pixel is near or far."""
    size = 2 * max(1, round(disparity_px.shape[1] * _EDGE_SHARE)) + 1
    window = np.ones((size, size), np.uint8)
    low, high = cv2.erode(disparity_px, window), cv2.dilate(disparity_px, window)
    nearest = np.where(disparity_px - low < high - disparity_px, low, high)
    return np.where(high - low > _LEAST_EDGE_PX, nearest, disparity_px).astype(np.float32)


def _fill_gaps(place: npt.NDArray[np.floating], best: npt.NDArray[np.int64]) -> None:
    """Put the columns of the surface behind, mirrored at its end, into the gaps of ``place``.

    Args:
        place: (H, W), columns of the source; of any value in gaps.
        best: (H, W), larger where nearer, -1 in gaps.
    """
    width = best.shape[1]
    columns = np.arange(width)
    left = np.maximum.accumulate(np.where(best < 0, -1, columns), axis=1)
    right = np.minimum.accumulate(np.where(best < 0, width, columns)[:, ::-1], axis=1)[:, ::-1]
    row, column = np.nonzero(best < 0)
    ends = left[row, column], right[row, column]
    inside = [np.clip(end, 0, width - 1) for end in ends]
    nearness = [
        np.where(end == at, best[row, at], np.iinfo(np.int64).max)
        for end, at in zip(ends, inside, strict=True)
    ]
    end = np.where(nearness[0] <= nearness[1], *inside)
    mirrored = place[row, end] - (column - end)
    place[row, column] = np.clip(mirrored, 0, width - 1)
