"""Continuing a run: its own configuration is taken up, and what contradicts it is named."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.training.checkpoint import Checkpoint
from depthcli.training.config.changes import resolve
from depthcli.training.config_differences import another_run, differences
from depthcli.training.loop import CHECKPOINT

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from depthcli.training.config.schema import TrainConfig


def saved_run(folder: Path) -> Checkpoint | None:
    """The checkpoint of a folder; None where a run would begin.

    Raises:
        CheckpointError: there is one that cannot be used.
    """
    path = folder / CHECKPOINT
    return Checkpoint.load(path) if path.is_file() else None


def continued(
    folder: Path, saved: TrainConfig, method: str, files: Iterable[Path], settings: Iterable[str]
) -> TrainConfig:
    """The configuration of a run that goes on: its own.

    Args:
        folder: of the run.
        saved: the run's configuration.
        method: that was named.
        files: of differences that were given again; may be none.
        settings: that were given again; may be none.

    Raises:
        CheckpointError: what was given is not what the run has.
        UsageError: a file or setting is wrong.
    """
    given = resolve(saved, files, settings)
    strange = differences(saved, given)
    if saved.method != method:
        strange = (f'method is "{saved.method}" there, "{method}" here', *strange)
    if strange:
        raise another_run(folder / CHECKPOINT, strange)
    return saved
