"""A checksum of options and facts, the same in every process and on every machine."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from fractions import Fraction
from pathlib import PurePath


def fingerprint(*facts: object) -> str:
    """What results follow from, in 64 hex digits: other facts give other digits.

    Facts are numbers, texts, enumerations, fractions and paths; tuples, lists, mappings and
    dataclasses of them, whose fields count with their names.

    Raises:
        TypeError: something else, which could look different the next time.
    """
    text = json.dumps([_json_value(fact) for fact in facts], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _json_value(fact: object) -> object:
    """What JSON has words for."""
    if isinstance(fact, Enum):
        return fact.value
    if fact is None or isinstance(fact, bool | int | float | str):
        return fact
    if isinstance(fact, Fraction | PurePath):
        return str(fact)
    if is_dataclass(fact):
        return {field.name: _json_value(getattr(fact, field.name)) for field in fields(fact)}
    if isinstance(fact, Mapping):
        return {str(key): _json_value(value) for key, value in fact.items()}
    if isinstance(fact, tuple | list):
        return [_json_value(part) for part in fact]
    raise TypeError(f"{type(fact).__name__} has no fingerprint")
