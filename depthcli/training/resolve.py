"""The configuration of a run: a new one's from what was given, a folder's own where it goes on."""

from collections.abc import Sequence
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.training.checkpoint import Checkpoint
from depthcli.training.config.changes import resolve
from depthcli.training.config.presets import preset_file
from depthcli.training.config.schema import TrainConfig
from depthcli.training.config_differences import another_run, differences
from depthcli.training.folder import CHECKPOINT
from depthcli.training.methods.registry import check_terms, default_config


def resolve_config(
    method: str,
    preset: str | None = None,
    files: Sequence[Path] = (),
    settings: Sequence[str] = (),
    folder: Path | None = None,
) -> TrainConfig:
    """The configuration that a method, a preset, files of differences and settings stand for.

    They count in this order, settings are ``a.b=c``; a run in ``folder`` has its own.

    Raises:
        UsageError: a name or a value is wrong.
        CheckpointError: the folder's run has not what was given.
    """
    usual = default_config(method)
    files = [preset_file(preset), *files] if preset else files
    saved = None if folder is None else saved_run(folder)
    if folder is not None and saved is not None:
        return _continued(folder, saved.config, method, files, settings)
    resolved = resolve(usual, files, settings)
    if resolved.method != method:
        raise UsageError(
            f"the settings are of method {resolved.method}, not {method}: name that one, or leave "
            "their method out"
        )
    check_terms(resolved)
    return resolved


def saved_run(folder: Path) -> Checkpoint | None:
    """The checkpoint of a folder; None where a run would begin.

    Raises:
        CheckpointError: there is one that cannot be used.
    """
    path = folder / CHECKPOINT
    return Checkpoint.load(path) if path.is_file() else None


def _continued(
    folder: Path, saved: TrainConfig, method: str, files: Sequence[Path], settings: Sequence[str]
) -> TrainConfig:
    """A run's own configuration; what was given again has to be the same."""
    strange = differences(saved, resolve(saved, files, settings))
    if saved.method != method:
        strange = (f'method is "{saved.method}" there, "{method}" here', *strange)
    if strange:
        raise another_run(folder / CHECKPOINT, strange)
    return saved
