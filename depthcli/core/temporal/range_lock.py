"""The range of a video's preview, held steady over time."""

import math


class RangeLock:
    """The two ends of a colour range, each an exponential mean over time.

    Without it every frame would be stretched to its own percentiles, and one near object passing
    by would change the colour of everything else. Ends of positive values are averaged as
    logarithms.
    """

    def __init__(self) -> None:
        self._ends: tuple[float, float] | None = None

    def step(
        self, low: float, high: float, kept: float, *, is_cut: bool = False
    ) -> tuple[float, float]:
        """The low and the high end for the next frame, of its own ends.

        ``kept`` is the past's share, 0 to 1, as ``exp(-interval / time constant)``; in another
        scene, which begins with a cut, the past means nothing.
        """
        if self._ends is None or is_cut:
            self._ends = (low, high)
        else:
            before_low, before_high = self._ends
            self._ends = (
                _weighted_mean(before_low, low, kept),
                _weighted_mean(before_high, high, kept),
            )
        return self._ends


def _weighted_mean(before: float, now: float, kept: float) -> float:
    if before > 0 and now > 0:
        return math.exp(kept * math.log(before) + (1 - kept) * math.log(now))
    return kept * before + (1 - kept) * now
