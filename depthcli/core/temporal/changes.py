"""Differences between consecutive pictures of a video: motion and scene cuts."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.colour import luma
from depthcli.core.resize import resize_area

THUMBNAIL_PX = 192
_BLUR_PX = 5
_MOVING_DIFFERENCE = 0.06
_STATIC_DIFFERENCE = 0.02
_CUT_MIN_DIFFERENCE = 0.08
_CUT_RATIO = 3.0
_CUT_DECAY = 0.8


@dataclass(frozen=True, slots=True)
class Change:
    """How a picture differs from the one before."""

    #: (h, w) float32 in [0, 1], of brightness averaged over 5×5 pixels of the thumbnail, against
    #: noise
    difference: npt.NDArray[np.float32]
    is_cut: bool  #: whether a new scene begins

    @property
    def static_weight(self) -> npt.NDArray[np.float32]:
        """(h, w) float32: 1 where nothing moves, 0 where brightness changes by 6 % or more.

        The largest change in the 3×3 neighbourhood counts, since depth changes around a moving
        edge before brightness does.
        """
        largest = cv2.dilate(self.difference, np.ones((3, 3), np.uint8))
        weight: npt.NDArray[np.float32] = 1 - np.clip(
            largest / np.float32(_MOVING_DIFFERENCE), 0, 1
        )
        return weight

    @property
    def is_static(self) -> npt.NDArray[np.bool_]:
        """(h, w): where brightness changes by less than 2 %."""
        return self.difference < _STATIC_DIFFERENCE


class ChangeDetector:
    """Compares each picture of a video with the one before.

    It is a cut if the mean change is at least 8 % of full brightness and at least three times the
    running mean of the changes in this scene.
    """

    def __init__(self) -> None:
        self._blurred: npt.NDArray[np.float32] | None = None
        self._mean_change = 0.0

    def step(self, thumbnail: npt.NDArray[np.float32]) -> Change:
        """The change to the next picture's :func:`thumbnail`; the first picture is a cut."""
        blurred = np.asarray(
            cv2.blur(thumbnail, (_BLUR_PX, _BLUR_PX), borderType=cv2.BORDER_REPLICATE), np.float32
        )
        before, self._blurred = self._blurred, blurred
        if before is None or before.shape != blurred.shape:
            return Change(np.ones_like(blurred), is_cut=True)
        difference = np.abs(blurred - before)
        mean = float(difference.mean())
        is_cut = mean >= max(_CUT_MIN_DIFFERENCE, _CUT_RATIO * self._mean_change)
        self._mean_change = (
            0.0 if is_cut else _CUT_DECAY * self._mean_change + (1 - _CUT_DECAY) * mean
        )
        return Change(difference, is_cut)


def thumbnail(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """A picture's luma, downscaled so that its long side has at most 192 pixels.

    Args:
        pixels: (H, W) or (H, W, 3) RGB; uint8, uint16, or float32 in [0, 1].

    Returns:
        (h, w) float32 in [0, 1].
    """
    height, width = pixels.shape[:2]
    scale = min(1.0, THUMBNAIL_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return luma(resize_area(np.asarray(pixels), *size))
