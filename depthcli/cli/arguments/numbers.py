"""Range checks and parsers of numeric options."""

import math
import re

import typer

from depthcli.core.camera import FOCAL_PX, HFOV_DEG
from depthcli.core.text import short_repr
from depthcli.errors import UsageError

_PNG_SCALES = (1e-3, 1e6)
_LARGEST_M = 1e9
_LARGEST_PX = 20_000


def finite(value: float | None) -> float | None:
    """Refuse NaN and numbers beyond ±1e9."""
    if value is not None and not abs(value) <= _LARGEST_M:
        raise typer.BadParameter("must be a number up to 1e9")
    return value


def positive(value: float | None) -> float | None:
    """Refuse numbers that are not finite and above 0."""
    if value is not None and not 0 < value < math.inf:
        raise typer.BadParameter("must be greater than 0")
    return value


def png_scale_range(value: float | None) -> float | None:
    """Refuse a PNG scale outside of 0.001 to 1000000 units per metre."""
    if value is not None and not _PNG_SCALES[0] <= value <= _PNG_SCALES[1]:
        raise typer.BadParameter("must be from 0.001 to 1000000")
    return value


def not_negative(value: float | None) -> float | None:
    """Refuse numbers that are not finite and at least 0."""
    if value is not None and not 0 <= value < math.inf:
        raise typer.BadParameter("must be 0 or greater")
    return value


def focal_length(value: float | None) -> float | None:
    """Refuse a focal length in pixels that is out of range."""
    if value is not None and not FOCAL_PX.holds(value):
        raise typer.BadParameter(f"must be {FOCAL_PX.what}")
    return value


def field_of_view(value: float | None) -> float | None:
    """Refuse a field of view in degrees that is out of range."""
    if value is not None and not HFOV_DEG.holds(value):
        raise typer.BadParameter(f"must be {HFOV_DEG.what}")
    return value


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
