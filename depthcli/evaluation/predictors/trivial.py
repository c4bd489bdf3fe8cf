"""Trivial baselines, which ignore the picture."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import DepthKind, DepthMap
from depthcli.datasets.base import DepthDataset
from depthcli.errors import DatasetError
from depthcli.evaluation.choices import Source
from depthcli.evaluation.predictors.base import Sample
from depthcli.metrics.pixels import MAX_DEPTH_M, MIN_DEPTH_M

TRIVIAL_NAMES = ("constant mean", "per-pixel mean")
"""Names of the rows of :func:`fit_trivial`, in its order."""


@dataclass(frozen=True, slots=True)
class TrivialPredictor:
    """The same depth map for every picture."""

    name: str  #: name of the row
    depth: DepthMap  #: the map, metres
    source: Source = Source.TRIVIAL  #: always trivial
    kind: DepthKind = DepthKind.METRIC  #: always metric
    model_sha256: str | None = None  #: always None

    def predict(self, sample: Sample) -> DepthMap:
        """The same map for every picture."""
        del sample
        return self.depth


def fit_trivial(
    dataset: DepthDataset,
    train: Sequence[int],
    *,
    min_m: float = MIN_DEPTH_M,
    max_m: float = MAX_DEPTH_M,
    progress: Progress = NO_PROGRESS,
    workers: int = 0,
) -> tuple[TrivialPredictor, TrivialPredictor]:
    """Constant mean and per-pixel mean of the training depth, read once, in constant memory.

    Only depth in the open interval (``min_m``, ``max_m``) is used; with 0 workers, pairs are read
    in the calling thread.

    Raises:
        DatasetError: no training pair, no valid pixel, or pairs of different sizes.
    """
    sums, counts = np.array([]), np.array([], np.int64)
    advance = progress.begin("mean of training images", len(train))
    with closing(ordered_map(dataset.depth_m, train, workers=workers)) as maps:
        for i, depth_m in zip(train, maps, strict=True):
            if not counts.size:
                sums, counts = np.zeros(depth_m.shape), np.zeros(depth_m.shape, np.int64)
            if depth_m.shape != sums.shape:
                raise DatasetError(f"depth of {dataset.ids[i]} has another size than the others")
            valid = (depth_m > min_m) & (depth_m < max_m)
            np.add(sums, depth_m, out=sums, where=valid)
            counts += valid
            advance(1)
    if not counts.any():
        raise DatasetError("no training depth to take the mean of: baselines need training pairs")
    return _predictors(sums, counts)


def _predictors(
    sums: npt.NDArray[np.float64], counts: npt.NDArray[np.int64]
) -> tuple[TrivialPredictor, TrivialPredictor]:
    mean_m = float(sums.sum() / counts.sum())
    # A pixel that was never valid, for example in a corner, gets the constant mean.
    per_pixel_m = np.divide(sums, counts, out=np.full_like(sums, mean_m), where=counts > 0)
    constant = DepthMap(np.full(sums.shape, mean_m, np.float32))
    constant_name, per_pixel_name = TRIVIAL_NAMES
    return (
        TrivialPredictor(constant_name, constant),
        TrivialPredictor(per_pixel_name, DepthMap(per_pixel_m.astype(np.float32))),
    )
