"""Frame rates as the fractions that they are, and clocks that hold them."""

import math
from dataclasses import dataclass
from fractions import Fraction

FALLBACK_RATE = Fraction(25)
"""Frames a second where nothing is stated."""
_NTSC = tuple(Fraction(n * 1000, 1001) for n in (12, 15, 24, 30, 48, 60, 120, 240))
_DECIMALS = (2, 3)
_SAME = 2e-5
_LARGEST_DENOMINATOR = 1_000_000
_FASTEST = 10_000
_SLOWEST = Fraction(1, 100_000_000)
_MOST_TICKS = 1_200_000
_COARSE_TICKS = 1000
_LONGEST_STEP = 1 << 28  # ticks; MP4 keeps the distance of two frames in 32 bits


def exact_rate(fps: float | Fraction) -> Fraction | None:
    """The fraction behind a decoder's frame rate, in frames a second.

    Containers that keep decimals or whole nanoseconds write 29.97 or 33366700 ns for 30000/1001;
    such values become the NTSC rate that they stand for. So do averages within 0.002 % of an NTSC
    or a whole rate. Every other fraction with a denominator up to a million is found exactly. None
    if the value says nothing (zero, negative, not finite, absurd).
    """
    fps = float(fps)
    if not math.isfinite(fps) or not 0 < fps <= _FASTEST:
        return None
    for rate in (*_NTSC, Fraction(round(fps) or 1)):
        if abs(fps / float(rate) - 1) < _SAME or _is_rounded(fps, rate):
            return rate
    return Fraction(fps).limit_denominator(_LARGEST_DENOMINATOR) or Fraction(fps)


def rate_text(rate: Fraction) -> str:
    """``30000/1001``; ``25/1`` for whole rates, so that there is one form to parse."""
    return f"{rate.numerator}/{rate.denominator}"


def _is_rounded(fps: float, rate: Fraction) -> bool:
    """Whether a value is an NTSC rate cut to two or three decimals, 23.98 say."""
    return rate.denominator > 1 and any(fps == round(float(rate), n) for n in _DECIMALS)


@dataclass(frozen=True, slots=True)
class Timing:
    """When the frames of a video are shown."""

    rate: Fraction  #: frames a second; the mean where frames are not evenly spaced
    tick_s: Fraction = Fraction(1, 1000)  #: seconds of which the source's times are multiples

    @property
    def is_countable(self) -> bool:
        """Whether FFmpeg and MP4, which count in 32 bits, can state the rate."""
        return self.rate >= _SLOWEST and max(self.rate.as_integer_ratio()) < 1 << 31

    @property
    def clock(self) -> Fraction:
        """Seconds a tick of a clock that has a tick at each of the frames.

        Both those on the rate's grid and those at any time of the source are exact, unless it
        would take more ticks than a container can count.
        """
        grid, source = self.rate.numerator, self.tick_s.denominator
        most = min(_MOST_TICKS, int(_LONGEST_STEP * self.rate))
        wishes = (math.lcm(grid, source), source, grid, _COARSE_TICKS)
        return Fraction(1, next((ticks for ticks in wishes if ticks <= most), _COARSE_TICKS))
