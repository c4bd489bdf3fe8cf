"""Resolving the configuration of a run from a method, a preset, TOML files and settings."""

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

from depthcli.core.options import short_repr, suggestion
from depthcli.errors import UsageError
from depthcli.io.storage.paths import read_regular
from depthcli.lab.training.checkpoint import CHECKPOINT, saved_checkpoint
from depthcli.lab.training.config import TrainConfig, check_config, updated
from depthcli.lab.training.init_weights import settings_of
from depthcli.lab.training.methods.registry import check_terms, default_config
from depthcli.lab.training.methods.table import PRESETS
from depthcli.lab.training.provenance import config_differences, mismatch_error

PRESET_FOLDER = Path(__file__).parent / "presets"
_MAX_BYTES = 2**20


def resolve_config(
    method: str,
    preset: str | None = None,
    files: Sequence[Path] = (),
    settings: Sequence[str] = (),
    folder: Path | None = None,
    init: Path | None = None,
) -> TrainConfig:
    """A method's default configuration, overridden by a preset, files and ``a.b=c`` settings.

    A folder's checkpoint has the last word, but for more epochs. The method ``prompted`` takes the
    network of ``init``.
    """
    usual = default_config(method)
    if usual.generator.prompt and init is not None:
        usual = updated(usual, settings_of(init))
    if preset and preset not in PRESETS:
        advice = suggestion(preset, PRESETS, f"choose from {', '.join(PRESETS)}")
        raise UsageError(f"no preset '{preset}'", advice)
    if preset and PRESETS[preset] not in ("", method):
        raise UsageError(f"the preset {preset} is for the method {PRESETS[preset]}, not {method}")
    files = [PRESET_FOLDER / f"{preset}.toml", *files] if preset else files
    saved = None if folder is None else saved_checkpoint(folder)
    if folder is not None and saved is not None:
        # Code to import is named by the command, never by a file alone.
        loss = replace(saved.config.loss, custom={})
        base = replace(saved.config, loss=loss)
        current = replace(apply_overrides(base, files, settings), method=method)
        mismatches = config_differences(saved.config, current)
        if mismatches:
            raise mismatch_error(folder / CHECKPOINT, mismatches)
        return current
    resolved = apply_overrides(usual, files, settings)
    if resolved.method != method:
        raise UsageError(f"the settings are of method {resolved.method}, not {method}")
    if resolved.generator.prompt and folder is not None and init is None:
        raise UsageError(f"{method} adds layers to a trained network", "give that with {init}")
    check_terms(resolved)
    return resolved


def apply_overrides(
    base: TrainConfig, files: Iterable[Path], settings: Iterable[str]
) -> TrainConfig:
    """Apply TOML files, then ``a.b=c`` settings, to a base configuration."""
    for file in files:
        try:
            base = updated(base, tomllib.loads(read_regular(file, _MAX_BYTES).decode("utf-8-sig")))
        except OSError as error:
            raise UsageError(f"cannot read the configuration {file}: {error.strerror}") from None
        except (ValueError, UsageError) as error:
            raise UsageError(f"the configuration {file} cannot be used: {error}") from None
    for setting in settings:
        base = updated(base, _nested(setting))
    check_config(base)
    return base


def _nested(setting: str) -> dict[str, Any]:
    key, equals, text = setting.partition("=")
    if not equals:
        raise UsageError(f"{short_repr(setting)} is not of the form a.b=value")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except ValueError:  # text without quotes
        value = text
    parts = key.split(".", 2)  # the third is a name of loss.custom, which may have dots
    return reduce(lambda nested, part: {part: nested}, reversed(parts), value)
