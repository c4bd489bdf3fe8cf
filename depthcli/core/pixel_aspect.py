"""Pixels that are not square."""

from fractions import Fraction

PIXEL_ASPECTS = 1e-6, 1e6
"""Least and largest width of a pixel by its height."""

_MOST = 1000


def pixel_aspect_of(stated: Fraction | None, *, is_turned: bool) -> float:
    """Width by height of an upright pixel; 1 if it is not stated, or absurd.

    Args:
        stated: width by height of a pixel as stored; None or 0 if it is not stated.
        is_turned: whether rows become columns.
    """
    if not stated or not Fraction(1, _MOST) <= stated <= _MOST:
        return 1.0
    return float(1 / stated if is_turned else stated)
