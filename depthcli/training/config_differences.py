"""Differences between two runs: settings, by their names for ``--set``, and data."""

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
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
    return value_differences(dict(_flat(saved)), dict(_flat(given)))


def _flat(config: TrainConfig) -> Iterator[tuple[str, Any]]:
    for name, value in dataclasses.asdict(config).items():
        if isinstance(value, dict):
            yield from ((f"{name}.{key}", item) for key, item in value.items())
        else:
            yield name, value


def value_differences(there: Mapping[str, object], here: Mapping[str, object]) -> tuple[str, ...]:
    """Each value by its name that both have, and that differs.

    >>> value_differences({"coding": "log", "min_m": 0.4}, {"coding": "linear"})
    ('coding is "log" there, "linear" here',)
    """
    return tuple(
        f"{name} is {json.dumps(there[name])} there, {json.dumps(here[name])} here"
        for name in there
        if name in here and there[name] != here[name]
    )


def data_differences(saved: RunProgress, given: RunProgress) -> tuple[str, ...]:
    """Differences in the pairs of training and validation, one line each.

    A folder may have moved: if both have a fingerprint, its name is not compared.
    """
    mismatches = []
    if (saved.train_ids, saved.held_out_ids) != (given.train_ids, given.held_out_ids):
        there, here = _pair_count(saved), _pair_count(given)
        mismatches.append(f"the data set is another one ({there} there, {here} here)")
    elif not (saved.fingerprints and given.fingerprints):
        mismatches += _named(saved, given, "data")
    elif saved.fingerprints[0] != given.fingerprints[0]:
        mismatches.append("the data set has other files or focal lengths")
    return (*mismatches, *_named(saved, given, "hfov_deg", "aspect"))


def source_differences(saved: RunProgress, given: RunProgress) -> tuple[str, ...]:
    """Differences in extra pairs and initial weights, one line each.

    A run without ``--init`` may resume one that had it.
    """
    mismatches = _named(saved, given, "extra")
    both = saved.fingerprints and given.fingerprints
    if both and not mismatches and saved.fingerprints[1:] != given.fingerprints[1:]:
        mismatches = ("the extra pairs have other files or focal lengths",)
    return (*mismatches, *(_named(saved, given, "start") if given.start else ()))


def _pair_count(progress: RunProgress) -> str:
    return f"{len(progress.train_ids)} pairs and {len(progress.held_out_ids)} held out"


def _named(saved: RunProgress, given: RunProgress, *names: str) -> tuple[str, ...]:
    there, here = ({name: getattr(one, name) for name in names} for one in (saved, given))
    return value_differences(there, here)


def mismatch_error(path: Path, mismatches: Sequence[str]) -> CheckpointError:
    """The error to raise for a checkpoint of another run."""
    return CheckpointError(
        f"{path} belongs to another run: {'; '.join(mismatches)}; to continue it, "
        "give the same settings and data, or give another --out"
    )
