"""Numbers of the command line that have to lie in a range."""

import math

import typer

_STRAIGHT_ANGLE_DEG = 180.0


def finite(value: float | None) -> float | None:
    """Refuse infinity and not-a-number, which a float option would take."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter("must be a number")
    return value


def positive(value: float | None) -> float | None:
    """Refuse what is not a number above 0."""
    if value is not None and not 0 < value < math.inf:
        raise typer.BadParameter("must be greater than 0")
    return value


def not_negative(value: float | None) -> float | None:
    """Refuse what is not a number from 0 up."""
    if value is not None and not 0 <= value < math.inf:
        raise typer.BadParameter("must be 0 or greater")
    return value


def field_of_view(value: float | None) -> float | None:
    """Refuse what is not an angle between 0 and 180 degrees."""
    if value is not None and not 0 < value < _STRAIGHT_ANGLE_DEG:
        raise typer.BadParameter("must be between 0 and 180 degrees")
    return value
