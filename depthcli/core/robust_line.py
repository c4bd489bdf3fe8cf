"""A straight line through points of which some are wrong."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

_STEPS = 50
_NORMAL = 1.4826  # standard deviation over median absolute deviation, of a normal distribution
_CUTOFF = 4.685  # 95 % efficiency for normal errors
_EXACT = 1e-6  # relative; depth maps are float32
_MOST = 100_000  # points in each step

_Values = npt.NDArray[np.float64]


class Line(NamedTuple):
    """y = slope · x + intercept."""

    slope: float
    intercept: float

    def residuals(self, x: _Values, y: _Values) -> _Values:
        """How far each point is above the line, in y: (N,) float64."""
        return y - (self.slope * x + self.intercept)


def robust_line(x: _Values, y: _Values) -> tuple[Line, npt.NDArray[np.bool_]]:
    """The line that fits most points best.

    An MM-like estimate: the line of least absolute deviations, then iteratively reweighted least
    squares with Tukey's biweight, whose width follows from the median absolute residual of the
    first line. Points farther than 4.685 standard deviations from the line have no effect.
    Of more than 100,000 points, this many, evenly spaced in their order, determine the line.

    Source: Holland, Welsch: Robust regression using iteratively reweighted least-squares.
    Communications in Statistics A6, 1977; Yohai: High breakdown-point and high efficiency robust
    estimates for regression. Annals of Statistics 15, 1987.

    Args:
        x: (N,) float64, not all equal.
        y: (N,) float64.

    Returns:
        The line, and which points it was fitted to: (N,) bool.
    """
    chosen = np.linspace(0, len(x) - 1, min(len(x), _MOST)).astype(np.int64)
    some_x, some_y = x[chosen], y[chosen]
    least = _EXACT * float(np.median(np.abs(some_y)))
    line = _line(some_x, some_y, np.ones_like(some_x))
    for _ in range(_STEPS):
        residuals = line.residuals(some_x, some_y)
        line = _line(some_x, some_y, 1 / np.maximum(np.abs(residuals), least))
    spread = float(np.median(np.abs(line.residuals(some_x, some_y))))
    width = _CUTOFF * max(_NORMAL * spread, least)
    for _ in range(_STEPS):
        share = np.minimum(np.abs(line.residuals(some_x, some_y)) / width, 1)
        line = _line(some_x, some_y, (1 - share**2) ** 2)
    return line, np.abs(line.residuals(x, y)) < width


def _line(x: _Values, y: _Values, weights: _Values) -> Line:
    """The line of weighted least squares; level if the points of weight have one x."""
    weights = weights / weights.sum()
    mean_x, mean_y = float(weights @ x), float(weights @ y)
    spread = float(weights @ (x - mean_x) ** 2)
    slope = float(weights @ ((x - mean_x) * (y - mean_y))) / spread if spread else 0.0
    return Line(slope, mean_y - slope * mean_x)
