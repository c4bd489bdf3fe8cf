"""Overrides of a configuration: TOML files, then ``a.b=c`` settings.

Unknown names and values of a wrong type are refused.
"""

import ast
import tomllib
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

from depthcli.core.text import short_repr
from depthcli.core.validation import FieldError, merged
from depthcli.errors import UsageError
from depthcli.io.storage.paths import read_regular
from depthcli.training.config import TrainConfig, check_range, check_sides

T = TypeVar("T")
_MAX_FILE_BYTES = 2**20


def apply_overrides(
    base: TrainConfig, files: Iterable[Path], settings: Iterable[str]
) -> TrainConfig:
    """Apply TOML files, then ``a.b=c`` settings, to a base configuration.

    Raises:
        UsageError: a name is unknown, a value has the wrong type or is out of range, or a file is
            not TOML.
    """
    for file in files:
        try:
            changes = tomllib.loads(read_regular(file, _MAX_FILE_BYTES).decode())
        except OSError as error:
            raise UsageError(f"cannot read the configuration {file}: {error.strerror}") from None
        except (ValueError, RecursionError) as error:
            raise UsageError(f"the configuration {file} is not TOML in UTF-8: {error}") from None
        try:
            base = updated(base, changes)
        except UsageError as error:
            raise UsageError(f"{file}: {error}") from None
    for setting in settings:
        base = updated(base, _nested(setting))
    check_range(base)
    check_sides(base)
    return base


def updated(config: T, changes: object) -> T:
    """A copy with some fields replaced; nested mappings replace fields of nested dataclasses.

    Raises:
        UsageError: a name is unknown or a value has the wrong type.
    """
    try:
        return merged(config, changes)
    except FieldError as refused:
        raise UsageError(str(refused)) from None


def _nested(setting: str) -> dict[str, Any]:
    key, equals, text = setting.partition("=")
    if not equals:
        raise UsageError(f"{short_repr(setting)} is not of the form a.b=value")
    words = {"true": True, "false": False}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # for example of "1if", which is text
            value = words[text.lower()] if text.lower() in words else ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        value = text
    *outer, last = key.split(".")
    nested: dict[str, Any] = {last: value}
    for part in reversed(outer):
        nested = {part: nested}
    return nested


FOLDER = Path(__file__).parent / "presets"


def preset_file(name: str) -> Path:
    """The TOML file of a preset.

    Raises:
        UsageError: there is no such preset.
    """
    if name not in preset_names():
        raise UsageError(f"no preset '{name}'; choose from {', '.join(preset_names())}")
    return FOLDER / f"{name}.toml"


def preset_names() -> tuple[str, ...]:
    """Names of the presets, in alphabetic order."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))
