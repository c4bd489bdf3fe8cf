"""Paired differences between rows, with intervals by a bootstrap over scenes.

Pictures of one scene are correlated, so scenes are resampled, not pictures.
Source: Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13 (percentiles).
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from depthcli.evaluation.differences import Difference, Interval
from depthcli.evaluation.report import ReportRow
from depthcli.metrics.choices import Alignment
from depthcli.metrics.depth import METRICS

_RESAMPLES = 10_000
_BLOCK = 100
"""Resamplings at a time, which bounds the memory for data sets of many scenes."""
_PERCENTILES = (2.5, 97.5)


def scene_interval(values: npt.NDArray[np.float64], scenes: Sequence[str]) -> Interval:
    """The mean over pictures, and its bootstrap interval with scenes resampled.

    ``values`` (N,) has one value per picture, or NaN, and ``scenes`` the scene of each. One scene
    alone has no interval.
    """
    known = np.isfinite(values)
    _, scene = np.unique(np.asarray(scenes)[known], return_inverse=True)
    sums = np.bincount(scene, values[known])
    counts = np.bincount(scene)
    if not len(sums):
        return Interval(np.nan, np.nan, np.nan)
    mean = float(sums.sum() / counts.sum())
    if len(sums) == 1:  # whose resamplings are all the same, however much other scenes differ
        return Interval(mean, np.nan, np.nan)
    share, rng, means = np.full(len(sums), 1 / len(sums)), np.random.default_rng(0), []
    for _ in range(_RESAMPLES // _BLOCK):
        drawn = rng.multinomial(len(sums), share, _BLOCK)
        means.append((drawn @ sums) / (drawn @ counts))
    low, high = np.percentile(np.concatenate(means), _PERCENTILES)
    return Interval(mean, float(low), float(high))


def differences_from(
    name: str, groups: Mapping[str, Sequence[ReportRow]], scenes: Mapping[str, str]
) -> tuple[Difference, ...]:
    """Paired differences between one row and every other of the same alignment.

    ``groups`` has the rows of the seeds by name, with scores per image, which are averaged over the
    seeds; ``scenes`` has the scene of each image id.
    """
    found = []
    for alignment in dict.fromkeys(row.alignment for row in groups[name]):
        own = _per_image(groups[name], alignment)
        order = [scenes[image.id] for image in groups[name][0].images]
        for other, rows in groups.items():
            if other == name or all(row.alignment is not alignment for row in rows):
                continue
            values = own - _per_image(rows, alignment)
            intervals = tuple(scene_interval(column, order) for column in values.T)
            is_scored = np.isfinite(values).any(1)  # others were excluded
            scenes_scored = set(np.asarray(order)[is_scored])
            found.append(Difference(name, other, alignment, intervals, len(scenes_scored)))
    return tuple(found)


def _per_image(rows: Sequence[ReportRow], alignment: Alignment | None) -> npt.NDArray[np.float64]:
    """(N, metrics): the scores of each image, averaged over the seeds."""
    seeds = [
        [[image.scores[metric] for metric in METRICS] for image in row.images]
        for row in rows
        if row.alignment is alignment
    ]
    averaged: npt.NDArray[np.float64] = np.asarray(seeds, np.float64).mean(0)
    return averaged
