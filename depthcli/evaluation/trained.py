"""Training runs as rows: the pictures to compare them on, and grouping by seed."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from depthcli.datasets.base import DepthDataset
from depthcli.datasets.splits import Split, SplitName, is_label, label_id
from depthcli.errors import DatasetError, UsageError
from depthcli.evaluation.predictors.model import ModelPredictor
from depthcli.evaluation.table import EvalTask, plan_nyu
from depthcli.training.trained_run import TrainedRun

_SEED = re.compile(r"-seed\d+$")


@dataclass(frozen=True, slots=True)
class TrainedModel:
    """A training run and its exported model."""

    run: TrainedRun  #: the run
    predictor: ModelPredictor  #: its model, named as the run
    latency_ms: float  #: median latency of the network for one picture, milliseconds


def plan_comparison(
    dataset: DepthDataset,
    runs: Sequence[TrainedRun],
    split: SplitName = SplitName.VAL,
    limit: int | None = None,
) -> EvalTask:
    """Choose pictures that no run was trained on, at most ``limit``, evenly over the split.

    ``val`` is the pairs that the runs held out.

    Raises:
        DatasetError: it is not NYU Depth v2, a pair of the runs is missing, or the split has no
            test image.
        UsageError: the runs hold out different pairs, or one was trained on the test images.
    """
    if not all(map(is_label, dataset.ids)):
        raise DatasetError(
            "the data set is not NYU Depth v2: compare exported models on pairs of your own with "
            "'depthcli eval pairs'"
        )
    whole = _held_out(dataset, runs) if split is SplitName.VAL else plan_nyu(dataset, split)
    task = whole.subsampled(limit)
    for run in runs:
        seen = set(run.nyu_ids).intersection(map(label_id, task.ids))
        if seen:
            raise UsageError(
                f"{run.name} was trained on {len(seen)} of the {len(task.ids)} test pictures: "
                "choose another --split, or omit it"
            )
    return task


def _held_out(dataset: DepthDataset, runs: Sequence[TrainedRun]) -> EvalTask:
    first = runs[0]
    for run in runs:
        if (run.held_out_ids, run.train_ids) != (first.held_out_ids, first.train_ids):
            raise UsageError(
                f"{first.name} and {run.name} were trained on or hold out different pairs: "
                "compare them separately, or on another --split"
            )
    if not first.held_out_ids:
        raise UsageError(f"{first.name} held out no pair: compare on another --split")
    places = {name: i for i, name in enumerate(dataset.ids)}
    missing = [i for i in (*first.held_out_ids, *first.train_ids) if i not in places]
    if missing:
        raise DatasetError(
            f"{len(missing)} pairs of the runs are not here (first: {missing[0]}): "
            "give the data set that they were trained on"
        )
    train = tuple(places[i] for i in first.train_ids)
    test = tuple(places[i] for i in first.held_out_ids)
    return EvalTask(dataset, Split(SplitName.VAL, train, test, len(train), len(test)), test)


def group_by_seed(runs: Sequence[TrainedRun]) -> dict[str, tuple[TrainedRun, ...]]:
    """Runs that differ only in their seed, by their common name.

    ``cut-seed0`` and ``cut-seed1`` are seeds of ``cut``.

    Raises:
        UsageError: runs of one name differ in settings, data or initial weights, or have the same
            seed.
    """
    groups: dict[str, list[TrainedRun]] = {}
    for run in runs:
        groups.setdefault(_SEED.sub("", run.name), []).append(run)
    for members in groups.values():
        settings, seeds = {run.settings for run in members}, {run.seed for run in members}
        if len(settings) > 1 or len(seeds) < len(members):
            names = ", ".join(run.name for run in members)
            raise UsageError(
                f"{names} are not seeds of one configuration with the same data and initial "
                "weights: rename their folders"
            )
    return {name: tuple(members) for name, members in groups.items()}


def mean_and_std(values: Sequence[float]) -> tuple[float, float | None]:
    """Mean and sample standard deviation, which is None for a single value."""
    std = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return float(np.mean(values)), std
