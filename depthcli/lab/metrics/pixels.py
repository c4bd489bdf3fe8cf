"""The valid pixels of a comparison, and the quantities that metrics share."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import cv2
import numpy as np

from depthcli.core.arrays import Float64Array, FloatArray

MIN_DEPTH_M = 1e-3
MAX_DEPTH_M = 10.0

_PART_PIXELS = 77_000  # pixels: longer arrays leave the cache, more parts cost more calls
_ARRAYS = 6


@dataclass(frozen=True)  # without slots: cached properties are stored in the instance
class DepthPixels:
    """The valid pixels of a comparison, which properties convert to float64."""

    truth: FloatArray  #: (N,) floats, metres, inside the range
    prediction: FloatArray  #: (N,) floats, metres, any value
    min_m: float = MIN_DEPTH_M  #: predictions are clamped to at least this
    max_m: float = MAX_DEPTH_M  #: predictions are clamped to at most this
    #: (6, at least N) float64, memory for the arrays below, which is reused for all parts of an
    #: image; None to allocate it
    scratch: Float64Array | None = None
    is_reversed: bool = False  #: whether an alignment of the image exchanged near and far

    @classmethod
    def of(
        cls,
        truth_m: FloatArray,
        predicted_m: FloatArray,
        *,
        min_m: float = MIN_DEPTH_M,
        max_m: float = MAX_DEPTH_M,
    ) -> Self:
        """Pixels with truth strictly inside (min_m, max_m); both are metres of one shape."""
        if truth_m.shape != predicted_m.shape:
            raise ValueError(f"truth is {truth_m.shape} but prediction is {predicted_m.shape}")
        valid = (truth_m > min_m) & (truth_m < max_m)
        if valid.all():  # as in most images; a copy by mask would cost more than a metric
            return cls(truth_m.ravel(), predicted_m.ravel(), min_m, max_m)
        return cls(truth_m[valid], predicted_m[valid], min_m, max_m)

    def __len__(self) -> int:
        return int(self.truth.size)

    def parts(self) -> Iterator[Self]:
        """Split the pixels into parts whose float64 arrays fit the processor's cache.

        Each part is valid until the next one is yielded. Without pixels, there is an empty one.
        """
        scratch = np.empty((_ARRAYS, min(_PART_PIXELS, len(self))))
        for start in range(0, max(1, len(self)), _PART_PIXELS):
            part = slice(start, start + _PART_PIXELS)
            pieces = self.truth[part], self.prediction[part]
            yield type(self)(*pieces, self.min_m, self.max_m, scratch)

    def _scratch_row(self, number: int) -> Float64Array | None:
        return None if self.scratch is None else self.scratch[number, : len(self)]

    @cached_property
    def truth_m(self) -> Float64Array:
        """(N,) g, metres, > 0."""
        return _as_float64(self.truth, self._scratch_row(0))

    @cached_property
    def predicted_m(self) -> Float64Array:
        """(N,) p, metres, > 0, clamped; NaN becomes ``min_m``."""
        values, low_m, high_m = self.prediction, self.min_m, self.max_m
        exact = _as_float64(values, self._scratch_row(1))
        if exact.size and low_m <= float(values.min()) and float(values.max()) <= high_m:
            return exact  # the usual case; NaN fails the comparison
        np.clip(exact, low_m, high_m, out=exact)
        exact[np.isnan(exact)] = low_m
        return exact

    @cached_property
    def error_m(self) -> Float64Array:
        """(N,) p − g."""
        return np.subtract(self.predicted_m, self.truth_m, out=self._scratch_row(2))

    @cached_property
    def ratio(self) -> Float64Array:
        """(N,) p / g."""
        return np.divide(self.predicted_m, self.truth_m, out=self._scratch_row(3))

    @cached_property
    def relative_error(self) -> Float64Array:
        """(N,) (p − g) / g."""
        return np.subtract(self.ratio, 1, out=self._scratch_row(4))

    @cached_property
    def log_error(self) -> Float64Array:
        """(N,) ln p − ln g."""
        return np.log(self.ratio, out=self._scratch_row(5))

    @cached_property
    def squared_log_error(self) -> float:
        """Σ (ln p − ln g)²."""
        return cv2.norm(self.log_error, cv2.NORM_L2SQR)


def _as_float64(values: FloatArray, out: Float64Array | None) -> Float64Array:
    if out is None:
        return values.astype(np.float64)
    np.copyto(out, values)
    return out
