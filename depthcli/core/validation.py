"""Strict validation of values from JSON, TOML and checkpoints against annotated dataclasses.

Numbers are finite and within 64 bits; ``Annotated[int, Rule(...)]`` adds a constraint. An error is
one line that names the field. (msgspec, which validates such types, too, ignores unknown fields of
a dataclass and takes 28 ms to load.)
"""

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass, replace
from enum import Enum
from fractions import Fraction
from functools import cache, partial
from pathlib import PurePath
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    TypeAlias,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from depthcli.core.options import Rule, short_repr

_T = TypeVar("_T")
_Read: TypeAlias = Callable[[Any], Any]
_INT64_END = 2**63
_MAX_CHARS = 60
_TYPE_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


class FieldError(ValueError):
    """A value that is not what it has to be.

    Attributes:
        path: of the field, such as ``input.width``; empty for the whole value.
        problem: what is wrong with it.
    """

    def __init__(self, problem: str, path: str = "") -> None:
        super().__init__(f"{path} {problem}".lstrip())
        self.path, self.problem = path, problem

    @classmethod
    def expected(cls, what: str, value: object) -> "FieldError":
        """An error for a value that is not as described."""
        return cls(f"has to be {what}, not {short_repr(value)}")

    def within(self, name: object) -> "FieldError":
        """Name the field of the error; the name may be untrusted."""
        word = name if isinstance(name, str) and name.isidentifier() else short_repr(name)
        return FieldError(self.problem, f"{word[:_MAX_CHARS]}.{self.path}".rstrip("."))


def parsed_json(text: str | bytes) -> object:
    """The value of a JSON text.

    Raises:
        FieldError: it is not valid JSON, is nested too deeply, or repeats a key in one object.
    """
    try:
        return _DECODER.decode(text if isinstance(text, str) else text.decode("utf-8-sig"))
    except RecursionError:
        raise FieldError("is not valid JSON (nested too deeply)") from None
    except ValueError as error:
        raise FieldError(f"is not valid JSON ({error})") from None


def validated(kind: type[_T], value: object) -> _T:
    """A value converted to a type; fields of a dataclass without a default are required.

    Raises:
        FieldError: something is missing, unknown, of another type or out of range.
    """
    result: _T = _reader(cast("Any", kind))(value)
    return result


def merged(base: _T, changes: object) -> _T:
    """A copy of a dataclass with some fields changed; nested dataclasses are merged as well.

    Raises:
        FieldError: something is unknown, of another type or out of range.
    """
    given: Any = base
    readers = dict(_field_readers(cast("Any", type(base))))
    for name in readers:
        old = getattr(base, name)
        if is_dataclass(old):
            readers[name] = partial(merged, old)
    result: _T = replace(given, **_read_fields(readers, changes))
    return result


def _unique_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name is there twice")
    return found


_DECODER = json.JSONDecoder(object_pairs_hook=_unique_keys)


@cache
def _field_readers(kind: type) -> dict[str, _Read]:
    """The reader of each field of a dataclass."""
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: _reader(hints[field.name]) for field in fields(kind)}


def _read_fields(readers: dict[Any, _Read], values: object) -> dict[Any, Any]:
    if not isinstance(values, dict):
        raise FieldError.expected(f"a group of {', '.join(readers)}", values)
    unknown = values.keys() - readers.keys()
    if unknown:
        known = f"is unknown; choose from {', '.join(readers)}"
        raise FieldError(known).within(min(unknown, key=str))
    read, name = {}, None
    try:
        for name, value in values.items():
            read[name] = readers[name](value)
    except FieldError as error:
        raise error.within(name) from None
    return read


@cache
def _reader(hint: Any, rule: Rule | None = None) -> _Read:  # noqa: ANN401, PLR0911 - one a kind
    """A function that converts a value to a type, or raises a ``FieldError``.

    Args:
        hint: an annotation.
        rule: describes the value in messages; None for the name of its type.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _with_rule(_reader(*parts), parts[1])
    if origin in (Union, UnionType) and parts[1] is NoneType:
        read = _reader(parts[0], rule)
        return lambda value: None if value is None else read(value)
    if origin in (Union, UnionType):
        return _either(*map(_reader, parts))
    if origin is Literal or (isinstance(hint, type) and issubclass(hint, Enum)):
        words = {str(choice): choice for choice in parts or hint}
        return _choice(words)
    if origin is tuple:
        return _sequence_reader(_reader(parts[0]), rule.what if rule else "a list")
    if origin is not None:  # dict, Mapping
        return _mapping_reader(_reader(parts[1]), rule.what if rule else "an object")
    if hint is Any:
        return _any_json
    if is_dataclass(hint):
        return _dataclass_reader(hint)
    return _scalar_reader(hint, rule or Rule(_TYPE_NAMES[hint], bool))


def _dataclass_reader(kind: Any) -> _Read:  # noqa: ANN401
    optional = {
        f.name for f in fields(kind) if (f.default, f.default_factory) != (MISSING, MISSING)
    }

    def read(values: Any) -> Any:  # noqa: ANN401
        given = _read_fields(_field_readers(kind), values)
        for name in _field_readers(kind):
            if name not in given and name not in optional:
                raise FieldError("is missing", name)
        return kind(**given)

    return read


def _scalar_reader(kind: type, rule: Rule) -> _Read:
    def read(value: Any) -> Any:  # noqa: ANN401
        is_int = type(value) is int and -_INT64_END <= value < _INT64_END
        if kind is float and is_int:
            return float(value)
        if (
            type(value) is not kind
            or (kind is int and not is_int)
            or (kind is float and rule.is_finite and not math.isfinite(cast("float", value)))
        ):
            raise FieldError.expected(rule.what, value)
        return value

    return read


def _with_rule(read: _Read, rule: Rule) -> _Read:
    def read_checked(value: Any) -> Any:  # noqa: ANN401
        result = read(value)
        if result is not None and not rule.holds(result):
            raise FieldError.expected(rule.what, value)
        return result

    return read_checked


def _either(first: _Read, second: _Read) -> _Read:
    """A reader of two types, whose errors are those of the first."""

    def read(value: Any) -> Any:  # noqa: ANN401
        try:
            return first(value)
        except FieldError:
            with suppress(FieldError):
                return second(value)
            raise

    return read


def _choice(choices: dict[str, Any]) -> _Read:
    def read(value: Any) -> Any:  # noqa: ANN401
        if not isinstance(value, str) or value not in choices:
            raise FieldError.expected(f"one of {', '.join(choices)}", value)
        return choices[value]

    return read


def _sequence_reader(read: _Read, what: str) -> Callable[[Any], tuple[Any, ...]]:
    def read_all(value: Any) -> tuple[Any, ...]:  # noqa: ANN401
        if not isinstance(value, (list, tuple)):
            raise FieldError.expected(what, value)
        readers = dict.fromkeys(range(len(value)), read)
        return tuple(_read_fields(readers, dict(enumerate(value))).values())

    return read_all


def _mapping_reader(read: _Read, what: str) -> Callable[[Any], dict[str, Any]]:
    def read_all(value: Any) -> dict[str, Any]:  # noqa: ANN401
        if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
            raise FieldError.expected(what, value)
        return _read_fields(dict.fromkeys(value, read), value)

    return read_all


def _any_json(value: Any) -> Any:  # noqa: ANN401
    """Any JSON value."""
    if isinstance(value, dict):
        return {name: _any_json(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_any_json(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        raise FieldError.expected("a finite number", value)
    return value


def fingerprint(*values: object) -> str:
    """SHA-256 of values, in 64 hex digits.

    Values are numbers, texts, enumerations, fractions and paths, and tuples, lists, mappings and
    dataclasses of them; names of fields count.

    Raises:
        TypeError: a value of another type, whose text form may not be stable.
    """
    text = json.dumps(values, default=_json_value, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _json_value(value: object) -> object:
    """A value of a type that JSON does not have, as one that it has."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Fraction | PurePath):
        return str(value)
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} has no fingerprint")
