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
    return (*mismatches, *_named(saved, given, "hfov_deg"), *_named(saved, given, "aspect"))


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


def _named(saved: RunProgress, given: RunProgress, name: str) -> tuple[str, ...]:
    there, here = getattr(saved, name), getattr(given, name)
    line = f"{name} is {json.dumps(there)} there, {json.dumps(here)} here"
    return () if there == here else (line,)


def mismatch_error(path: Path, mismatches: Sequence[str]) -> CheckpointError:
    """The error to raise for a checkpoint of another run."""
    return CheckpointError(
        f"{path} belongs to another run: {'; '.join(mismatches)}; to continue it, "
        "give the same settings and data, or give another --out"
    )
