"""Differences between two runs: settings, by their names for ``--set``, and data."""

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import RunProgress
from depthcli.training.config.schema import TrainConfig


def differences(saved: TrainConfig, given: TrainConfig) -> tuple[str, ...]:
    """Each setting with both of its values; empty for equal configurations.

    >>> from depthcli.training.config.schema import TrainConfig
    >>> differences(TrainConfig(seed=0), TrainConfig(seed=1))
    ('seed is 0 there, 1 here',)
    """
    there, here = dict(_flat(saved)), dict(_flat(given))
    return tuple(
        f"{name} is {json.dumps(there[name])} there, {json.dumps(here[name])} here"
        for name in there
        if there[name] != here[name]
    )


def _flat(config: TrainConfig) -> Iterator[tuple[str, Any]]:
    for name, value in dataclasses.asdict(config).items():
        if isinstance(value, dict):
            yield from ((f"{name}.{key}", item) for key, item in value.items())
        else:
            yield name, value


def data_differences(saved: RunProgress, given: RunProgress) -> tuple[str, ...]:
    """Differences in training data and initial weights, one line each.

    A run without ``--init`` may resume one that had it.
    """
    mismatches = []
    if saved.train_ids != given.train_ids:
        counts = f"{len(saved.train_ids)} pairs there, {len(given.train_ids)} here"
        mismatches.append(f"the data set is another one ({counts})")
    for option in ("extra", "start"):
        there, here = getattr(saved, option), getattr(given, option)
        if there != here and (here or option == "extra"):
            mismatches.append(f"{option} is {json.dumps(there)} there, {json.dumps(here)} here")
    return tuple(mismatches)


def mismatch_error(path: Path, mismatches: Sequence[str]) -> CheckpointError:
    """The error to raise for a checkpoint of another run."""
    return CheckpointError(
        f"{path} belongs to another run: {'; '.join(mismatches)}; to continue it, "
        "give the same settings and data, or give another --out"
    )
