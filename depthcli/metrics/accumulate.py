"""Accumulating metrics over images: ``update`` adds sums, ``compute`` divides once."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

from depthcli.metrics.choices import Averaging
from depthcli.metrics.depth import METRICS
from depthcli.metrics.pixels import DepthPixels


@dataclass(frozen=True, slots=True)
class Scores:
    """One value for every metric of :data:`~depthcli.metrics.depth.METRICS`, in its order."""

    values: tuple[float, ...]

    @classmethod
    def of(cls, **named: float) -> Self:
        """Scores by name; NaN for every metric that is not named."""
        return cls(tuple(named.get(name, math.nan) for name in METRICS))

    def __getitem__(self, name: str) -> float:
        return self.values[list(METRICS).index(name)]

    def items(self) -> Iterator[tuple[str, float]]:
        """(name, value) of every metric."""
        return zip(METRICS, self.values, strict=True)


@dataclass(frozen=True, slots=True)
class PixelSums:
    """Sums of every metric, which can be computed in parallel and added."""

    pixel_count: int  #: how many pixels
    sums: tuple[tuple[float, ...], ...]  #: those of each metric, in the order of the table

    @classmethod
    def of(cls, pixels: DepthPixels) -> Self:
        """Sums over the pixels of one image; thread-safe."""
        parts = [[metric.sums(part) for metric in METRICS.values()] for part in pixels.parts()]
        columns = zip(*parts, strict=True)
        sums = tuple(tuple(map(sum, zip(*column, strict=True))) for column in columns)
        return cls(len(pixels), sums)

    def __add__(self, other: Self) -> Self:
        pairs = zip(self.sums, other.sums, strict=True)
        added = tuple(tuple(a + b for a, b in zip(x, y, strict=True)) for x, y in pairs)
        return type(self)(self.pixel_count + other.pixel_count, added)

    def scores(self) -> Scores:
        """Every metric over these pixels; NaN if there are none."""
        if not self.pixel_count:
            return Scores.of()
        metrics = zip(METRICS.values(), self.sums, strict=True)
        return Scores(tuple(m.finish(*(s / self.pixel_count for s in sums)) for m, sums in metrics))


class Accumulator:
    """Scores of a stream of images in constant memory.

    >>> import numpy as np
    >>> from depthcli.metrics.pixels import DepthPixels
    >>> truth = np.array([1.0, 2.0, 4.0])
    >>> total = Accumulator()
    >>> total.update(DepthPixels.of(truth, truth * 1.1))["d1"]
    1.0
    >>> round(total.compute()["abs_rel"], 6)
    0.1
    """

    def __init__(self, averaging: Averaging = Averaging.IMAGE) -> None:
        self.averaging = averaging
        self.image_count = 0
        self.empty_count = 0
        self._pixels: PixelSums | None = None
        self._image_sums = (0.0,) * len(METRICS)

    def update(self, pixels: DepthPixels) -> Scores:
        """Add one image and return its own scores; see :meth:`add`."""
        return self.add(PixelSums.of(pixels))

    def add(self, sums: PixelSums) -> Scores:
        """Add the sums of one image and return its own scores.

        An image without a valid pixel has no scores: it is counted in ``empty_count`` and not
        averaged.
        """
        scores = sums.scores()
        if not sums.pixel_count:
            self.empty_count += 1
            return scores
        self.image_count += 1
        self._pixels = self._pixels + sums if self._pixels else sums
        added = zip(self._image_sums, scores.values, strict=True)
        self._image_sums = tuple(a + b for a, b in added)
        return scores

    def compute(self) -> Scores:
        """Average over all images so far; NaN for every metric if there were none."""
        if self._pixels is None:
            return Scores.of()
        if self.averaging is Averaging.POOLED:
            return self._pixels.scores()
        return Scores(tuple(total / self.image_count for total in self._image_sums))
