"""Strict reading of a JSON object: every field is typed, and none is left over."""

from __future__ import annotations

import re
import sys
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from depthcli.core.text import shown
from depthcli.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

_MAX_TEXT = 1000
_MAX_NUMBER = sys.float_info.max  # not-a-number is not within it, either

_Choice = TypeVar("_Choice", bound=StrEnum)


class Fields:
    """The fields of one JSON object, each read once.

    Every method raises :class:`ModelError` if its field is missing or of another type;
    :meth:`close` raises it if a field was never asked for.
    """

    def __init__(self, values: object, where: str, path: str = "") -> None:
        self._where = where
        self._path = path
        if not isinstance(values, dict):
            self.fail("", "has to be a JSON object")
        self._values: dict[str, Any] = values
        self._left = set(values)

    def fail(self, name: str, problem: str) -> NoReturn:
        """Report a field.

        Raises:
            ModelError: always.
        """
        field = f"{self._path}{name}".rstrip(".")
        subject = f"{self._where}: {field}" if field else self._where
        raise ModelError(f"{subject} {problem}; correct the card or restore the model")

    def has(self, name: str) -> bool:
        """Whether the object has this field."""
        return name in self._values

    def close(self) -> None:
        """Nothing more will be read."""
        if self._left:
            self.fail(min(self._left), "is not a field of a card")

    def text(self, name: str) -> str:
        """A string with something in it."""
        value = self._take(name)
        if not isinstance(value, str) or not value.strip():
            self.fail(name, f"has to be text, not {shown(value)}")
        if not value.isprintable() or len(value) > _MAX_TEXT:
            self.fail(
                name, f"has to be at most {_MAX_TEXT} printable characters, not {shown(value)}"
            )
        return value

    def file_name(self, name: str) -> str:
        """A plain file name: a card never points outside its own folder."""
        value = self.text(name)
        if value in {".", ".."} or re.search(r"[/\\:\0]", value):
            self.fail(name, f"has to be a file name without a folder, not {shown(value)}")
        return value

    def sha256(self, name: str) -> str:
        """A checksum of 64 hex digits, returned in lower case."""
        value = self.text(name).lower()
        if not re.fullmatch(r"[0-9a-f]{64}", value):
            self.fail(name, "has to be 64 hex digits")
        return value

    def integer(self, name: str, *, minimum: int, maximum: int = 2**63 - 1) -> int:
        """A whole number, at least ``minimum`` and at most ``maximum``."""
        value = self._take(name)
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            self.fail(name, f"has to be a whole number from {minimum} up, not {shown(value)}")
        if value > maximum:
            self.fail(name, f"has to be at most {maximum}, not {shown(value)}")
        return value

    def number(self, name: str) -> float:
        """A finite number."""
        return self._number(name, self._take(name))

    def optional_number(self, name: str) -> float | None:
        """A finite number, or None where it is null or absent."""
        value = self._take(name) if self.has(name) else None
        return None if value is None else self._number(name, value)

    def numbers(self, name: str, lengths: Collection[int]) -> tuple[float, ...]:
        """A list of finite numbers, of one of the given lengths."""
        value = self._take(name)
        if not isinstance(value, list) or len(value) not in lengths:
            sizes = " or ".join(str(length) for length in sorted(lengths))
            self.fail(name, f"has to be a list of {sizes} numbers, not {shown(value)}")
        return tuple(self._number(name, number) for number in value)

    def flag(self, name: str) -> bool:
        """True or false."""
        value = self._take(name)
        if not isinstance(value, bool):
            self.fail(name, f"has to be true or false, not {shown(value)}")
        return value

    def choice(self, name: str, choices: type[_Choice]) -> _Choice:
        """One of a fixed set of words."""
        value = self._take(name)
        words = [choice.value for choice in choices]
        if value not in words:
            self.fail(name, f"has to be one of {', '.join(words)}, not {shown(value)}")
        return choices(value)

    def optional_choice(self, name: str, default: _Choice) -> _Choice:
        """One of the words of the default's kind, or the default where it is absent."""
        return self.choice(name, type(default)) if self.has(name) else default

    def section(self, name: str) -> Fields:
        """A nested object."""
        return Fields(self._take(name), self._where, f"{self._path}{name}.")

    def optional_section(self, name: str) -> Fields | None:
        """A nested object, or None where it is null. It has to be stated either way."""
        value = self._take(name)
        return None if value is None else Fields(value, self._where, f"{self._path}{name}.")

    def free(self, name: str) -> Mapping[str, Any]:
        """Any JSON object; empty where it is absent."""
        value = self._take(name) if self.has(name) else {}
        if not isinstance(value, dict):
            self.fail(name, "has to be a JSON object")
        return value

    def _take(self, name: str) -> object:
        if name not in self._values:
            self.fail(name, "is missing")
        self._left.discard(name)
        return self._values[name]

    def _number(self, name: str, value: object) -> float:
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not -_MAX_NUMBER <= value <= _MAX_NUMBER
        ):
            self.fail(name, f"must be a number, not {shown(value)}")
        return float(value)
