"""The configuration of a run: resolved from the options, or that of the checkpoint to resume."""

from collections.abc import Sequence
from pathlib import Path

from depthcli.errors import UsageError
from depthcli.training.checkpoint import CHECKPOINT, Checkpoint
from depthcli.training.config import TrainConfig
from depthcli.training.methods.registry import check_terms, default_config
from depthcli.training.provenance import config_differences, mismatch_error, value_differences
from depthcli.training.settings import apply_overrides, preset_file


def resolve_config(
    method: str,
    preset: str | None = None,
    files: Sequence[Path] = (),
    settings: Sequence[str] = (),
    folder: Path | None = None,
) -> TrainConfig:
    """A method's default configuration, overridden by a preset, files and ``a.b=c`` settings.

    Later ones override earlier ones. If ``folder`` has a checkpoint, its configuration is returned.

    Raises:
        UsageError: a name or a value is wrong.
        CheckpointError: the checkpoint has another configuration.
    """
    usual = default_config(method)
    files = [preset_file(preset), *files] if preset else files
    saved = None if folder is None else saved_checkpoint(folder)
    if folder is not None and saved is not None:
        return _resumed_config(folder, saved.config, method, files, settings)
    resolved = apply_overrides(usual, files, settings)
    if resolved.method != method:
        raise UsageError(
            f"the settings are of method {resolved.method}, not {method}: name that one, or leave "
            "their method out"
        )
    check_terms(resolved)
    return resolved


def saved_checkpoint(folder: Path) -> Checkpoint | None:
    """The checkpoint of a folder; None if there is none.

    Raises:
        CheckpointError: it cannot be used.
    """
    path = folder / CHECKPOINT
    return Checkpoint.load(path) if path.is_file() else None


def _resumed_config(
    folder: Path, saved: TrainConfig, method: str, files: Sequence[Path], settings: Sequence[str]
) -> TrainConfig:
    """The checkpoint's configuration, after checking that the options do not contradict it."""
    mismatches = (
        *value_differences({"method": saved.method}, {"method": method}),
        *config_differences(saved, apply_overrides(saved, files, settings)),
    )
    if mismatches:
        raise mismatch_error(folder / CHECKPOINT, mismatches)
    return saved
