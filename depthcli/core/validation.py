"""Strict validation of values from JSON, TOML and checkpoints against annotated dataclasses.

Numbers of a stated type are finite and within 64 bits; ``Annotated[int, Rule(...)]`` adds a
constraint. An error is one line that names the field. (msgspec, which validates such types, too,
ignores unknown fields of a dataclass and takes 28 ms to load.)
"""

import hashlib
import json
import math
import typing
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import MISSING, asdict, fields, is_dataclass
from enum import Enum
from fractions import Fraction
from functools import cache
from pathlib import PurePath
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar

from depthcli.core.options import Rule, short_repr

_T = TypeVar("_T")
_INT64_END = 2**63
_MAX_CHARS = 60
_TYPE_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


class FieldError(ValueError):
    """A problem of the field at a path such as ``input.width``, and errors of other fields."""

    def __init__(self, problem: str, path: str = "", *others: tuple[str, str]) -> None:
        self.faults = ((path, problem), *others)
        super().__init__("; ".join(f"{path} {problem}".lstrip() for path, problem in self.faults))

    @classmethod
    def expected(cls, what: str, value: object) -> "FieldError":
        """An error for a value that is not as described."""
        return cls(f"has to be {what}, not {short_repr(value)}")

    def within(self, name: object) -> "FieldError":
        """Name the field of the error; the name may be untrusted."""
        word = name if isinstance(name, str) and name.isidentifier() else short_repr(name)
        faults = [(f"{word[:_MAX_CHARS]}.{path}".rstrip("."), what) for path, what in self.faults]
        return FieldError(faults[0][1], faults[0][0], *faults[1:])


def parsed_json(text: str | bytes) -> object:
    """The value of a JSON text.

    Raises:
        FieldError: it is not valid JSON, or is nested too deeply.
    """
    try:
        return json.loads(text)
    except (RecursionError, ValueError) as error:
        raise FieldError(f"is not valid JSON ({error})") from None


def validated(kind: type[_T], value: object) -> _T:
    """A value converted to a type; fields of a dataclass without a default are required.

    Raises:
        FieldError: something is missing, unknown, of another type or out of range.
    """
    result: _T = _converted(kind, value)
    return result


def merged(base: _T, changes: object) -> _T:
    """A copy of a dataclass with some fields changed; nested ones and mappings are merged."""
    value: Any = base
    return validated(type(base), _overlaid(asdict(value), changes))


def _overlaid(base: object, changes: object) -> object:
    if not (isinstance(base, dict) and isinstance(changes, dict)):
        return changes
    return base | {name: _overlaid(base.get(name), value) for name, value in changes.items()}


@cache
def _hints(kind: Any) -> tuple[dict[str, Any], frozenset[str]]:  # noqa: ANN401 - a dataclass
    """The annotations of a dataclass's fields, and the names of those without a default."""
    every = typing.get_type_hints(kind, include_extras=True)
    attributes = fields(kind)
    required = {f.name for f in attributes if (f.default, f.default_factory) == (MISSING, MISSING)}
    return {field.name: every[field.name] for field in attributes}, frozenset(required)


def _read_fields(
    hints: Mapping[Any, Any],
    values: object,
    required: Collection[Any] = (),
    *,
    is_list: bool = False,
) -> dict[Any, Any]:
    """Values by name, each as its annotation demands; of a list, the first fault is enough."""
    if not isinstance(values, dict):
        raise FieldError.expected(f"a group of {', '.join(hints)}", values)
    faults, parsed, unknown = list[tuple[str, str]](), {}, []
    for name, value in values.items():
        if name not in hints:
            unknown.append(name)
            continue
        hint = hints[name]
        try:
            # Most fields are texts, in a million rows of a manifest.
            is_text = hint is str and type(value) is str
            parsed[name] = value if is_text else _converted(hint, value)
        except FieldError as error:
            faults += error.within(name).faults
            if is_list:
                break
    if unknown:
        problem = f"is unknown; choose from {', '.join(hints)}"
        faults[:0] = FieldError(problem).within(unknown[0]).faults
    if len(parsed) < len(hints):
        missing = [name for name in hints if name in required and name not in values]
        faults += [(name, "is missing") for name in missing]
    if faults:
        (path, problem), *others = faults
        raise FieldError(problem, path, *others)
    return parsed


def _converted(hint: Any, value: Any, rule: Rule | None = None) -> Any:  # noqa: ANN401
    """A value as an annotation demands it; the rule describes it in messages."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is None and hasattr(hint, "__dataclass_fields__"):
        hints, required = _hints(hint)
        return hint(**_read_fields(hints, value, required))
    if origin is Annotated:
        result = _converted(parts[0], value, parts[1])
        if result is not None and not parts[1].holds(result):
            raise FieldError.expected(parts[1].what, value)
        return result
    if origin in (typing.Union, UnionType):
        if parts[1] is NoneType:
            return None if value is None else _converted(parts[0], value, rule)
        try:
            return _converted(parts[0], value)
        except FieldError:
            with suppress(FieldError):
                return _converted(parts[1], value)
            raise
    return _plain(hint, value, rule) if origin is None else _items(origin, parts, value, rule)


def _items(origin: Any, parts: tuple[Any, ...], value: Any, rule: Rule | None) -> Any:  # noqa: ANN401
    """One of some words, a tuple, or a mapping."""
    if origin is Literal:
        return _choice({str(choice): choice for choice in parts}, value)
    if origin is tuple:
        if not isinstance(value, (list, tuple)):
            raise FieldError.expected(rule.what if rule else "a list", value)
        hints = dict.fromkeys(range(len(value)), parts[0])
        return tuple(_read_fields(hints, dict(enumerate(value)), is_list=True).values())
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
        raise FieldError.expected(rule.what if rule else "an object", value)
    return _read_fields(dict.fromkeys(value, parts[1]), value, is_list=True)


def _plain(hint: Any, value: Any, rule: Rule | None) -> Any:  # noqa: ANN401
    """A word of an enumeration, a number, a text, or any JSON value."""
    if hint is Any:
        return value
    if issubclass(hint, Enum):
        return _choice({str(choice): choice for choice in hint}, value)
    is_int = type(value) is int and -_INT64_END <= value < _INT64_END
    if hint is float and is_int:
        return float(value)
    if (
        type(value) is not hint
        or (hint is int and not is_int)
        or (hint is float and (rule is None or rule.is_finite) and not math.isfinite(value))
    ):
        raise FieldError.expected(rule.what if rule else _TYPE_NAMES[hint], value)
    return value


def _choice(choices: dict[str, Any], value: object) -> object:
    if not isinstance(value, str) or value not in choices:
        raise FieldError.expected(f"one of {', '.join(choices)}", value)
    return choices[value]


def fingerprint(*values: object) -> str:
    """SHA-256 of values, in 64 hex digits.

    Values are numbers, texts, enumerations, fractions and paths, and tuples, lists, mappings and
    dataclasses of them; names of fields count.

    Raises:
        TypeError: a value of another type, whose text form may not be stable.
    """
    text = json.dumps(values, default=_json_value, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _json_value(value: Any) -> object:  # noqa: ANN401
    """A value of a type that JSON does not have, as one that it has."""
    if isinstance(value, Fraction | PurePath):
        return str(value)
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return dict(value)  # TypeError of other types
