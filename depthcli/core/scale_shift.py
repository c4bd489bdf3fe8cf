"""Scale and shift from values to known depth, of which some may be wrong."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

_STEPS = 50
_NORMAL = 1.4826  # standard deviation over median absolute deviation, of a normal distribution
_CUTOFF = 4.685  # 95 % efficiency for normal errors
_EXACT = 1e-6  # relative; depth maps are float32
_MOST = 100_000  # points in each step

_Values = npt.NDArray[np.float64]


class ScaleShift(NamedTuple):
    """wanted = scale · value + shift."""

    scale: float
    shift: float


@dataclass(frozen=True, slots=True)
class Pairs:
    """Values and what they should become.

    Attributes:
        values: (N,) float64.
        wanted: (N,) float64.
        unit: (N,) float64 above 0, in which the error of each pair is measured.
        error_sd: expected standard deviation of the errors, in their units.
        shift_sd: expected standard deviation of the shift, in the median unit; infinite if
            nothing is known of it.
    """

    values: _Values
    wanted: _Values
    unit: _Values
    error_sd: float = 1.0
    shift_sd: float = math.inf

    def errors(self, fit: ScaleShift) -> _Values:
        """Absolute error of each pair, in its unit: (N,) float64."""
        return np.abs(fit.scale * self.values + fit.shift - self.wanted) / self.unit

    def thinned(self) -> "Pairs":
        """At most 100,000 pairs, evenly spaced in their order."""
        count = len(self.values)
        chosen = np.linspace(0, count - 1, min(count, _MOST)).astype(np.int64)
        some = self.values[chosen], self.wanted[chosen], self.unit[chosen]
        return Pairs(*some, self.error_sd, self.shift_sd)


def least_squares(pairs: Pairs, weights: _Values | None = None) -> ScaleShift:
    """The most probable scale and shift if all errors and the shift are normally distributed.

    Args:
        pairs: their values are not all equal, or the shift is expected to be finite.
        weights: (N,) float64; None if all are equal.
    """
    weights = np.ones_like(pairs.values) if weights is None else weights
    centre, unit = float(np.median(np.abs(pairs.values))) or 1.0, float(np.median(pairs.unit))
    rows = np.stack([pairs.values / centre, np.full_like(pairs.values, unit)], axis=1)
    rows /= pairs.unit[:, None]
    weighted = rows * weights[:, None]
    normal = weighted.T @ rows + np.diag([0.0, (pairs.error_sd / pairs.shift_sd) ** 2])
    scale, shift = np.linalg.lstsq(normal, weighted.T @ (pairs.wanted / pairs.unit))[0]
    return ScaleShift(float(scale) / centre, float(shift) * unit)


def robust(pairs: Pairs) -> tuple[ScaleShift, _Values]:
    """Like :func:`least_squares`, but wrong pairs have no effect.

    An MM-like estimate: the least absolute errors, then iteratively reweighted least squares with
    Tukey's biweight. The standard deviation of the errors is 1.4826 times the median error of the
    first fit.
    Pairs farther than 4.685 standard deviations from the fit have no effect.
    Of more than 100,000 pairs, this many determine the fit.

    Source: Holland, Welsch: Robust regression using iteratively reweighted least-squares.
    Communications in Statistics A6, 1977; Yohai: High breakdown-point and high efficiency robust
    estimates for regression. Annals of Statistics 15, 1987.

    Returns:
        The fit, and the weight of each pair in it, 0 of wrong ones: (N,) float64 in [0, 1].
    """
    some = pairs.thinned()
    least = _EXACT * float(np.median(np.abs(some.wanted) / some.unit))
    fit = least_squares(some)
    some = replace(some, error_sd=max(float(np.median(some.errors(fit))), least))
    for _ in range(_STEPS):
        fit = least_squares(some, some.error_sd / np.maximum(some.errors(fit), least))
    some = replace(some, error_sd=max(_NORMAL * float(np.median(some.errors(fit))), least))
    width = _CUTOFF * some.error_sd
    for _ in range(_STEPS):
        fit = least_squares(some, _biweights(some.errors(fit) / width))
    return fit, _biweights(pairs.errors(fit) / width)


def _biweights(errors: _Values) -> _Values:
    """Tukey's biweight of errors, 0 from 1 on."""
    return (1 - np.minimum(errors, 1) ** 2) ** 2
