"""What changes from one picture of a video to the next."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.colour import luma
from depthcli.core.resize import resize_area

GUIDE_PX = 192
_BLUR_PX = 5
_MOVED = 0.06
_STILL = 0.02
_CUT_LEAST = 0.08
_CUT_TIMES = 3.0
_CUT_MEMORY = 0.8


@dataclass(frozen=True, slots=True)
class Change:
    """How one picture differs from the one before."""

    #: (h, w) float32 in [0, 1], of brightness averaged over 5×5 guide pixels, so that noise counts
    #: little
    difference: npt.NDArray[np.float32]
    is_cut: bool  #: whether another scene begins

    @property
    def stillness(self) -> npt.NDArray[np.float32]:
        """(h, w) float32: 1 where nothing moves, 0 where brightness changes by 6 % or more.

        The largest change among the nine neighbours counts, since depth changes around a moving
        edge before brightness does.
        """
        largest = cv2.dilate(self.difference, np.ones((3, 3), np.uint8))
        still: npt.NDArray[np.float32] = 1 - np.clip(largest / np.float32(_MOVED), 0, 1)
        return still

    @property
    def is_still(self) -> npt.NDArray[np.bool_]:
        """(h, w): where brightness changes by less than 2 %."""
        return self.difference < _STILL


class Changes:
    """The change of each picture of a video against the one before.

    A cut is where the mean change is at least 8 % of full brightness and at least three times the
    running mean of the changes in this scene.
    """

    def __init__(self) -> None:
        self._blurred: npt.NDArray[np.float32] | None = None
        self._usual = 0.0

    def step(self, guide: npt.NDArray[np.float32]) -> Change:
        """The change to the next picture's :func:`guide`; the first picture of all is a cut."""
        blurred = box_mean(guide)
        before, self._blurred = self._blurred, blurred
        if before is None or before.shape != blurred.shape:
            return Change(np.ones_like(blurred), is_cut=True)
        difference = np.abs(blurred - before)
        mean = float(difference.mean())
        is_cut = mean >= max(_CUT_LEAST, _CUT_TIMES * self._usual)
        self._usual = 0.0 if is_cut else _CUT_MEMORY * self._usual + (1 - _CUT_MEMORY) * mean
        return Change(difference, is_cut)


def guide(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """A picture's brightness at a size at which changes are looked for.

    Of (H, W) or (H, W, 3) RGB, uint8, uint16, or float32 in [0, 1]; (h, w) float32 in [0, 1], the
    long side at most 192 pixels.
    """
    height, width = pixels.shape[:2]
    scale = min(1.0, GUIDE_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return luma(resize_area(np.asarray(pixels), *size))


def box_mean(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """The mean over 5×5 pixels around each; (h, w) float32 in and out, edges repeated."""
    height, width = values.shape
    wide = np.pad(values, _BLUR_PX // 2, mode="edge")
    rows = np.add.reduce([wide[i : i + height] for i in range(_BLUR_PX)])
    total = np.add.reduce([rows[:, i : i + width] for i in range(_BLUR_PX)])
    mean: npt.NDArray[np.float32] = total / np.float32(_BLUR_PX**2)
    return mean
