"""A checksum of options and other values, the same in every process and on every machine."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from pathlib import PurePath


def fingerprint(*values: object) -> str:
    """SHA-256 of values, in 64 hex digits.

    Values are numbers, texts, enumerations, fractions and paths, and tuples, lists, mappings and
    dataclasses of them; names of fields count.

    Raises:
        TypeError: a value of another type, whose text form may not be stable.
    """
    text = json.dumps([_json_value(value) for value in values], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _json_value(value: object) -> object:
    """The value as types that JSON has."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Fraction | PurePath):
        return str(value)
    if is_dataclass(value):
        return {field.name: _json_value(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _json_value(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [_json_value(part) for part in value]
    raise TypeError(f"{type(value).__name__} has no fingerprint")
