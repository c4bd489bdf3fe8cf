"""Pixels that are not square."""

from fractions import Fraction

_MAX_DENOMINATOR = 1000
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


def pixel_aspect_warning(pixel_aspect: float) -> str | None:
    """A warning about pixels that are not square, as in anamorphic film; None if they are.

    ``pixel_aspect`` is width by height of a pixel.
    """
    ratio = Fraction(pixel_aspect).limit_denominator(_MAX_DENOMINATOR)
    if ratio == 1:
        return None
    return (
        f"the pixels are not square ({ratio.numerator}:{ratio.denominator}), and the network sees "
        "them as they are stored; for better depth, scale it to square pixels first"
    )
