"""What two runs do not have in common: settings by the names that ``--set`` takes, and data."""

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
    """What a run learned from, and what was asked for, where they differ.

    A fresh run without weights to start from takes up the saved ones.
    """
    strange = []
    if saved.train_ids != given.train_ids:
        counts = f"{len(saved.train_ids)} pairs there, {len(given.train_ids)} here"
        strange.append(f"the data set is another one ({counts})")
    for option in ("extra", "start"):
        there, here = getattr(saved, option), getattr(given, option)
        if there != here and (here or option == "extra"):
            strange.append(f"{option} is {json.dumps(there)} there, {json.dumps(here)} here")
    return tuple(strange)


def another_run(path: Path, strange: Sequence[str]) -> CheckpointError:
    """The error of a checkpoint that is not of the run that was asked for; to be raised."""
    return CheckpointError(
        f"{path} belongs to another run: {'; '.join(strange)}; give what it was begun with "
        "to continue it, or another --out"
    )
