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
