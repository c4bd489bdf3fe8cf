"""The warning about pixels that are not square."""

from fractions import Fraction


def pixel_aspect_warning(ratio: Fraction | None) -> str | None:
    """A warning about pixels that are not square, as in anamorphic film.

    Args:
        ratio: width by height of a pixel; None if it is not stated.
    """
    if not ratio or ratio == 1:
        return None
    return (
        f"the pixels are not square ({ratio.numerator}:{ratio.denominator}), and the network sees "
        "them as they are stored; for better depth, scale the video to square pixels first"
    )
