"""Frame rates as exact fractions, and time bases that represent them."""

import math
import re
from dataclasses import dataclass
from fractions import Fraction

FALLBACK_RATE = Fraction(25)
"""Frames a second if the source states no rate."""
_NTSC = tuple(Fraction(n * 1000, 1001) for n in (12, 15, 24, 30, 48, 60, 120, 240))
_DECIMALS = (2, 3)
_TOLERANCE = 2e-5
_MAX_DENOMINATOR = 1_000_000
_MAX_FPS = 10_000
_MIN_FPS = Fraction(1, 100_000_000)
_MAX_TICKS = 1_200_000
_COARSE_TICKS = 1000
_MAX_DURATION_TICKS = 1 << 28  # ticks; MP4 keeps the distance of two frames in 32 bits


def exact_rate(fps: float | Fraction) -> Fraction | None:
    """The exact fraction of a rounded frame rate, in frames a second.

    Containers that store decimals or whole nanoseconds write 29.97 or 33366700 ns for 30000/1001;
    such values become the NTSC rate, as do averages within 0.002 % of an NTSC or a whole rate. Any
    other fraction with a denominator up to a million is found exactly. None if the value is not
    valid (zero, negative, not finite, too large).
    """
    fps = float(fps)
    if not math.isfinite(fps) or not 0 < fps <= _MAX_FPS:
        return None
    for rate in (*_NTSC, Fraction(round(fps) or 1)):
        if abs(fps / float(rate) - 1) < _TOLERANCE or _is_rounded(fps, rate):
            return rate
    return Fraction(fps).limit_denominator(_MAX_DENOMINATOR) or Fraction(fps)


def rate_text(rate: Fraction) -> str:
    """``30000/1001``; ``25/1`` for whole rates, so that there is one form to parse."""
    return f"{rate.numerator}/{rate.denominator}"


def _is_rounded(fps: float, rate: Fraction) -> bool:
    """Whether a value is an NTSC rate rounded to two or three decimals, such as 23.98."""
    return rate.denominator > 1 and any(fps == round(float(rate), n) for n in _DECIMALS)


def parse_rate(text: str | None) -> Fraction | None:
    """The rate that :func:`rate_text` writes; None for any other text."""
    found = re.fullmatch(r"([1-9]\d{0,14})/([1-9]\d{0,14})", text or "", re.ASCII)
    return Fraction(int(found[1]), int(found[2])) if found else None


@dataclass(frozen=True, slots=True)
class Timing:
    """When the frames of a video are shown."""

    rate: Fraction  #: frames a second, as stated; often the mean if it varies
    tick_s: Fraction = Fraction(1, 1000)  #: seconds that all times of the source are multiples of
    source_rate: Fraction | None = None  #: frames a second of the source; None if not known
    #: difference of the frames' numbers in the source; None if the numbers follow the times
    step: int | None = 1

    @property
    def has_all_frames(self) -> bool:
        """Whether the frames are consecutive ones of the source."""
        return self.rate == self.source_rate

    @property
    def is_representable(self) -> bool:
        """Whether FFmpeg and MP4, which use 32-bit integers, can represent the rate."""
        return self.rate >= _MIN_FPS and max(self.rate.as_integer_ratio()) < 1 << 31

    @property
    def time_base(self) -> Fraction:
        """Seconds a tick of a time base that represents the times of all frames.

        Multiples of the frame interval and all times of the source are exact. Where that takes more
        ticks than a container can represent, multiples of the interval are, if these can be; other
        times are rounded.
        """
        grid, source = self.rate.numerator, self.tick_s.denominator
        most = min(_MAX_TICKS, int(_MAX_DURATION_TICKS * self.rate))
        candidates = (math.lcm(grid, source), most // grid * grid or source, _COARSE_TICKS)
        return Fraction(1, next((ticks for ticks in candidates if ticks <= most), _COARSE_TICKS))
