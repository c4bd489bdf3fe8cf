"""Numbers of the command line that have to lie in a range."""

import math
import re

import typer

from depthcli.core.camera import FOCAL_PX, HFOV_DEG
from depthcli.core.text import shown
from depthcli.errors import UsageError

_PNG_SCALES = (1e-3, 1e6)
_LARGEST_M = 1e9
_LARGEST_PX = 20_000


def finite(value: float | None) -> float | None:
    """Refuse not-a-number, and what is no depth in any unit."""
    if value is not None and not abs(value) <= _LARGEST_M:
        raise typer.BadParameter("must be a number up to 1e9")
    return value


def positive(value: float | None) -> float | None:
    """Refuse what is not a number above 0."""
    if value is not None and not 0 < value < math.inf:
        raise typer.BadParameter("must be greater than 0")
    return value


def png_scale_range(value: float | None) -> float | None:
    """Refuse a scale with which a map would have one step, or none."""
    if value is not None and not _PNG_SCALES[0] <= value <= _PNG_SCALES[1]:
        raise typer.BadParameter("must be from 0.001 to 1000000")
    return value


def not_negative(value: float | None) -> float | None:
    """Refuse what is not a number from 0 up."""
    if value is not None and not 0 <= value < math.inf:
        raise typer.BadParameter("must be 0 or greater")
    return value


def focal_length(value: float | None) -> float | None:
    """Refuse a focal length in pixels that no picture has."""
    if value is not None and not FOCAL_PX.holds(value):
        raise typer.BadParameter(f"must be {FOCAL_PX.what}")
    return value


def field_of_view(value: float | None) -> float | None:
    """Refuse an angle that no picture has."""
    if value is not None and not HFOV_DEG.holds(value):
        raise typer.BadParameter(f"must be {HFOV_DEG.what}")
    return value


def parse_size(word: str) -> tuple[int, int]:
    """Width and height of ``640x480``.

    Raises:
        UsageError: it is not like that, or too large.
    """
    sides = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", word)
    if not sides:
        raise UsageError(f"--size {shown(word)} is not WIDTHxHEIGHT; for example 640x480")
    width, height = map(int, sides.groups())
    if not (0 < width <= _LARGEST_PX and 0 < height <= _LARGEST_PX):
        raise UsageError(f"--size {word!r}: each side is 1 to {_LARGEST_PX} pixels")
    return width, height


def parse_hfov_range(word: str) -> tuple[float, float]:
    """Narrowest and widest of ``30-110``, or twice the same of ``63.3``, degrees.

    Raises:
        UsageError: it is not like that, or no angle that a picture has.
    """
    low, dash, high = word.partition("-")
    try:
        angles = float(low), float(high if dash else low)
    except ValueError:
        raise UsageError(f"--hfov {word!r} is not LOW-HIGH; for example 50-80") from None
    if angles[0] > angles[1] or not all(map(HFOV_DEG.holds, angles)):
        raise UsageError(f"--hfov {word!r}: each is {HFOV_DEG.what}, the smaller first")
    return angles
