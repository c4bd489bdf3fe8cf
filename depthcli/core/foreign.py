"""Values that others wrote, in JSON, TOML or a checkpoint, as the types that a dataclass states.

The annotation of a field is its rule: numbers are finite and within 64 bits, and ``Annotated[int,
Rule(...)]`` says more. What does not hold is one line that names the field. (msgspec, which reads
such types, too, passes over unknown fields of a dataclass and takes 28 ms to load.)
"""

import json
import math
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass, replace
from enum import Enum
from functools import cache, partial
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeAlias,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from depthcli.core.text import shown

_T = TypeVar("_T")
_Read: TypeAlias = Callable[[Any], Any]
_LARGEST = 2**63
_DEEPEST = 32
_LONGEST = 60
_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


class FieldError(ValueError):
    """A value that is not what it has to be.

    Attributes:
        path: of the field, ``input.width`` say; empty for the whole.
        problem: what is wrong with it.
    """

    def __init__(self, problem: str, path: str = "") -> None:
        super().__init__(f"{path} {problem}".lstrip())
        self.path, self.problem = path, problem

    @classmethod
    def unless(cls, what: str, value: object) -> "FieldError":
        """For a value that is not what it has to be."""
        return cls(f"has to be {what}, not {shown(value)}")

    def within(self, name: object) -> "FieldError":
        """The same of a part that has this name, which others may have chosen."""
        word = name if isinstance(name, str) and name.isidentifier() else shown(name)
        return FieldError(self.problem, f"{word[:_LONGEST]}.{self.path}".rstrip("."))


class Rule(NamedTuple):
    """What holds of a value besides its type."""

    #: what it has to be, in words
    what: str
    holds: Callable[[Any], object]
    #: whether not-a-number and infinity are refused before
    is_finite: bool = True


def parsed_json(text: str | bytes) -> object:
    """What a JSON text says.

    Raises:
        FieldError: it is no JSON, is nested too deeply, or has a name twice in one object.
    """
    try:
        return _DECODER.decode(text if isinstance(text, str) else text.decode("utf-8-sig"))
    except RecursionError:
        raise FieldError("is not valid JSON (nested too deeply)") from None
    except ValueError as error:
        raise FieldError(f"is not valid JSON ({error})") from None


def built(kind: type[_T], value: object) -> _T:
    """A value as a type; fields of a dataclass that have no default have to be there.

    Raises:
        FieldError: something is missing, unknown, of another type or out of range.
    """
    made: _T = _reader(cast("Any", kind))(value)
    return made


def merged(base: _T, changes: object) -> _T:
    """A copy of a dataclass with some fields changed; those that are dataclasses are merged, too.

    Raises:
        FieldError: something is unknown, of another type or out of range.
    """
    given: Any = base
    readers = dict(_field_readers(cast("Any", type(base))))
    for name in readers:
        old = getattr(base, name)
        if is_dataclass(old):
            readers[name] = partial(merged, old)
    made: _T = replace(given, **_read_fields(readers, changes))
    return made


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name is there twice")
    return found


_DECODER = json.JSONDecoder(object_pairs_hook=_once)


@cache
def _field_readers(kind: type) -> dict[str, _Read]:
    """What reads each field of a dataclass."""
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: _reader(hints[field.name]) for field in fields(kind)}


def _read_fields(readers: dict[Any, _Read], values: object) -> dict[Any, Any]:
    if not isinstance(values, dict):
        raise FieldError.unless(f"a group of {', '.join(readers)}", values)
    strange = values.keys() - readers.keys()
    if strange:
        known = f"is unknown; choose from {', '.join(readers)}"
        raise FieldError(known).within(min(strange, key=str))
    made, name = {}, None
    try:
        for name, value in values.items():
            made[name] = readers[name](value)
    except FieldError as refused:
        raise refused.within(name) from None
    return made


@cache
def _reader(hint: Any, rule: Rule | None = None) -> _Read:  # noqa: ANN401, PLR0911 - one a kind
    """What turns a value into a type, or refuses it.

    Args:
        hint: an annotation.
        rule: what messages say of it, where that is more than its type.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _ruled(_reader(*parts), parts[1])
    if origin in (Union, UnionType) and parts[1] is NoneType:
        read = _reader(parts[0], rule)
        return lambda value: None if value is None else read(value)
    if origin is Literal or (isinstance(hint, type) and issubclass(hint, Enum)):
        words = {str(choice): choice for choice in parts or hint}
        return _choice(words)
    if origin is tuple:
        return _sequence_reader(_reader(parts[0]), rule.what if rule else "a list")
    if origin is not None:  # dict, Mapping
        return _mapping_reader(_reader(parts[1]), rule.what if rule else "an object")
    if hint is Any:
        return _free
    if is_dataclass(hint):
        return _dataclass_reader(hint)
    return _scalar_reader(hint, rule or Rule(_WORDS[hint], bool))


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
        is_int = type(value) is int and -_LARGEST <= value < _LARGEST
        if kind is float and is_int:
            return float(value)
        if (
            type(value) is not kind
            or (kind is int and not is_int)
            or (kind is float and rule.is_finite and not math.isfinite(cast("float", value)))
        ):
            raise FieldError.unless(rule.what, value)
        return value

    return read


def _ruled(read: _Read, rule: Rule) -> _Read:
    def ruled(value: Any) -> Any:  # noqa: ANN401
        made = read(value)
        if made is not None and not rule.holds(made):
            raise FieldError.unless(rule.what, value)
        return made

    return ruled


def _choice(choices: dict[str, Any]) -> _Read:
    def read(value: Any) -> Any:  # noqa: ANN401
        if not isinstance(value, str) or value not in choices:
            raise FieldError.unless(f"one of {', '.join(choices)}", value)
        return choices[value]

    return read


def _sequence_reader(read: _Read, what: str) -> Callable[[Any], tuple[Any, ...]]:
    def read_all(value: Any) -> tuple[Any, ...]:  # noqa: ANN401
        if not isinstance(value, (list, tuple)):
            raise FieldError.unless(what, value)
        places = dict.fromkeys(range(len(value)), read)
        return tuple(_read_fields(places, dict(enumerate(value))).values())

    return read_all


def _mapping_reader(read: _Read, what: str) -> Callable[[Any], dict[str, Any]]:
    def read_all(value: Any) -> dict[str, Any]:  # noqa: ANN401
        if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
            raise FieldError.unless(what, value)
        return _read_fields(dict.fromkeys(value, read), value)

    return read_all


def _free(value: Any, depth: int = 0) -> Any:  # noqa: ANN401
    """Anything that JSON can hold, as deep as people write it."""
    if depth > _DEEPEST:
        raise FieldError("is nested too deeply")
    if isinstance(value, dict):
        return {name: _free(item, depth + 1) for name, item in value.items()}
    if isinstance(value, list):
        return [_free(item, depth + 1) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        raise FieldError.unless("a finite number", value)
    return value
