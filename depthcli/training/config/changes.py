"""Changes to a configuration: files that hold only differences (TOML), then ``a.b=c`` settings.

Unknown names and ill-typed values are refused.
"""

from __future__ import annotations

import ast
import dataclasses
import tomllib
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from depthcli.core.text import shown
from depthcli.errors import UsageError
from depthcli.io.storage.regular import read_regular
from depthcli.training.config.ranges import check_range

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from depthcli.training.config.schema import TrainConfig

T = TypeVar("T")
_MAX_FILE_BYTES = 2**20
_LARGEST = 2**63


def resolve(base: TrainConfig, files: Iterable[Path], settings: Iterable[str]) -> TrainConfig:
    """Apply files of differences, then ``a.b=c`` settings, to a base configuration.

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
    return base


def updated(config: T, changes: Mapping[str, Any]) -> T:
    """A copy with some fields changed; nested mappings change nested configurations."""
    hints = get_type_hints(type(config))
    values: dict[str, Any] = {}
    for name, value in changes.items():
        if name not in hints:
            known = ", ".join(hints)
            raise UsageError(f"unknown setting {shown(name)}; choose from {known}")
        old = getattr(config, name)
        if dataclasses.is_dataclass(old):
            if not isinstance(value, dict):
                raise UsageError(f"'{name}' is a group; set {name}.SETTING=VALUE")
            values[name] = updated(old, value)
        else:
            values[name] = _checked(name, value, hints[name])
    return dataclasses.replace(config, **values)  # type: ignore[type-var]


def _nested(setting: str) -> dict[str, Any]:
    key, equals, text = setting.partition("=")
    if not equals:
        raise UsageError(f"'{setting}' is not of the form a.b=value")
    words = {"true": True, "false": False}
    try:
        value = words[text.lower()] if text.lower() in words else ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        value = text
    *outer, last = key.split(".")
    nested: dict[str, Any] = {last: value}
    for part in reversed(outer):
        nested = {part: nested}
    return nested


def _checked(name: str, value: Any, hint: Any) -> Any:  # noqa: ANN401
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise UsageError(f"{name} is one of {', '.join(get_args(hint))}, not {shown(value)}")
        return value
    if get_origin(hint) is tuple:
        kind, numbers = get_args(hint)[0], isinstance(value, (list, tuple))
        if numbers and all(_is_number(item, kind) for item in value):
            return tuple(kind(item) for item in value)
        raise UsageError(
            f"{name} is a list of {'whole ' if kind is int else ''}numbers, not {shown(value)}"
        )
    if hint is float and type(value) is int and abs(value) < _LARGEST:
        return float(value)
    if type(value) is not hint or (hint is int and abs(value) >= _LARGEST):
        raise UsageError(f"{name} is of type {hint.__name__}, not {shown(value)}")
    return value


def _is_number(value: object, kind: type) -> bool:
    return type(value) is kind or (type(value) is int and abs(value) < _LARGEST)
