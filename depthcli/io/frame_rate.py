"""Frame rates as the fractions that they are."""

from __future__ import annotations

import math
from fractions import Fraction

_NTSC = tuple(Fraction(n * 1000, 1001) for n in (12, 15, 24, 30, 48, 60, 120, 240))
_DECIMALS = (2, 3)
_SAME = 2e-5
_LARGEST_DENOMINATOR = 1_000_000
_FASTEST = 10_000


def exact_rate(fps: float) -> Fraction | None:
    """The fraction behind a decoder's floating-point frame rate.

    Containers that keep decimals or whole nanoseconds write 29.97 or 33366700 ns for 30000/1001;
    such values become the NTSC rate that they stand for. So do averages within 0.002 % of an NTSC
    or a whole rate. Every other fraction with a denominator up to a million is found exactly.

    Args:
        fps: frames a second.

    Returns:
        Frames a second; None if the value says nothing (zero, negative, not finite, absurd).
    """
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
