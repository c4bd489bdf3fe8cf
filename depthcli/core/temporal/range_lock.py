"""The colour range of a video's preview, smoothed over time."""

import math


class RangeLock:
    """The two ends of a colour range, each an exponential moving average.

    Without it every frame would be stretched to its own percentiles, and one near object passing
    by would change the colour of everything else. Positive ends are averaged as logarithms.
    """

    def __init__(self) -> None:
        self._ends: tuple[float, float] | None = None

    def step(
        self, low: float, high: float, decay: float, *, is_cut: bool = False
    ) -> tuple[float, float]:
        """The smoothed low and high end of the next frame.

        Args:
            low: the frame's own low end.
            high: the frame's own high end.
            decay: weight of the past, 0 to 1: ``exp(-interval / time constant)``.
            is_cut: whether a new scene begins, which drops the past.
        """
        if self._ends is None or is_cut:
            self._ends = (low, high)
        else:
            before_low, before_high = self._ends
            self._ends = (
                _weighted_mean(before_low, low, decay),
                _weighted_mean(before_high, high, decay),
            )
        return self._ends


def _weighted_mean(before: float, now: float, decay: float) -> float:
    if before > 0 and now > 0:
        return math.exp(decay * math.log(before) + (1 - decay) * math.log(now))
    return decay * before + (1 - decay) * now
