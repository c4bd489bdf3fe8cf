"""Range checks and parsers of numeric options."""

import math
import re
from collections.abc import Callable

import typer

from depthcli.core.camera import FOCAL_PX, HFOV_DEG
from depthcli.core.picture_options import EXPOSURE
from depthcli.core.text import short_repr
from depthcli.core.validation import Rule
from depthcli.errors import UsageError

_LARGEST_M = 1e9
_LARGEST_PX = 20_000


def _must_be(rule: Rule) -> Callable[[float | None], float | None]:
    """A callback of typer that refuses a value, unless it is None."""

    def check(value: float | None) -> float | None:
        if value is not None and not rule.holds(value):
            raise typer.BadParameter(f"must be {rule.what}")
        return value

    return check


finite = _must_be(Rule("a number up to 1e9", lambda x: abs(x) <= _LARGEST_M))
positive = _must_be(Rule("greater than 0", lambda x: 0 < x < math.inf))
not_negative = _must_be(Rule("0 or greater", lambda x: 0 <= x < math.inf))
png_scale_range = _must_be(Rule("from 0.001 to 1000000", lambda x: 1e-3 <= x <= 1e6))  # noqa: PLR2004
focal_length = _must_be(FOCAL_PX)
field_of_view = _must_be(HFOV_DEG)
stops = _must_be(EXPOSURE)


def parse_size(word: str) -> tuple[int, int]:
    """Parse a width and height such as ``640x480``.

    Raises:
        UsageError: it is not of this form, or too large.
    """
    sides = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", word)
    if not sides:
        raise UsageError(f"--size {short_repr(word)} is not WIDTHxHEIGHT; for example 640x480")
    width, height = map(int, sides.groups())
    if not (0 < width <= _LARGEST_PX and 0 < height <= _LARGEST_PX):
        raise UsageError(f"--size {word!r}: each side is 1 to {_LARGEST_PX} pixels")
    return width, height


def parse_hfov_range(word: str) -> tuple[float, float]:
    """Parse a range of degrees such as ``30-110``, or one value such as ``63.3``.

    Raises:
        UsageError: it is not of this form, or out of range.
    """
    low, dash, high = word.partition("-")
    try:
        angles = float(low), float(high if dash else low)
    except ValueError:
        raise UsageError(f"--hfov {word!r} is not LOW-HIGH; for example 50-80") from None
    if angles[0] > angles[1] or not all(map(HFOV_DEG.holds, angles)):
        raise UsageError(f"--hfov {word!r}: each is {HFOV_DEG.what}, the smaller first")
    return angles
