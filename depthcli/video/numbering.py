"""Patterns for the names of numbered files: ``plate.%04d.exr`` matches ``plate.1001.exr``.

So does ``plate.####.exr``, the notation of compositing programs.
"""

import re
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import UsageError

MAX_DIGITS = 12
"""Most digits of a frame's number."""
LAST_NUMBER = re.compile(r"(.*?)(\d+)(\D*)", re.ASCII)
"""The parts of a name without suffix: before its last number, that number, and after it."""
_SHORT = 4
"""Numbers with fewer digits and no leading zero are taken as not padded."""
# Before a digit, as in "take #2", # is no placeholder.
_PLACEHOLDER = re.compile(r"%(?:0(\d))?d|(#+)(?![#\d])", re.ASCII)
_MARKS = frozenset("%#$@*?")
_SEPARATORS = "._- "


class _Parts(NamedTuple):
    """A pattern, divided at its last placeholder."""

    start: str
    digits: int  #: least number of digits
    end: str


def is_pattern(name: str) -> bool:
    """Whether a name has exactly one placeholder for a number."""
    return len(_PLACEHOLDER.findall(name)) == 1


def pattern_advice(name: str) -> str:
    """What to add to "no such file" for a name that looks like a pattern; else empty."""
    if _MARKS.isdisjoint(name):
        return ""
    return "the name of an image sequence has one of %04d, %d and ####"


def check_folders(pattern: Path) -> None:
    """Check that the number is not in the name of a folder, unless there is such a folder.

    Raises:
        UsageError: it is.
    """
    for folder in pattern.parents:
        if is_pattern(folder.name) and not folder.is_dir():
            raise UsageError(
                f"{pattern} has a number in the name of a folder; all files go into one folder: "
                "give the number in their name alone"
            )


def numbered_name(pattern: str, number: int) -> str:
    """The name of the file with a number."""
    parts = _parts(pattern)
    return pattern if parts is None else f"{parts.start}{number:0{parts.digits}d}{parts.end}"


def number_in(pattern: str, name: str) -> int | None:
    """The number in a name; None if the name does not match the pattern."""
    parts = _parts(pattern)
    if parts is None:
        return None
    digits = name[len(parts.start) : len(name) - len(parts.end)]
    fits = name.startswith(parts.start) and name.endswith(parts.end) and digits.isdecimal()
    if not fits or len(digits) > MAX_DIGITS or numbered_name(pattern, int(digits)) != name:
        return None
    return int(digits)


def pattern_of(stem: str) -> str | None:
    """A pattern that a name without suffix fits: ``p.####`` for ``p.0001``; None without number."""
    match = LAST_NUMBER.fullmatch(stem)
    if match is None:
        return None
    start, digits, end = match.groups()
    is_padded = len(digits) >= _SHORT or str(int(digits)) != digits
    pattern = start + ("#" * len(digits) if is_padded else "%d") + end
    return pattern if is_pattern(pattern) and number_in(pattern, stem) is not None else None


def base_name(stem: str) -> str:
    """The name of a sequence: ``plate`` of ``plate.%04d``."""
    parts = _parts(stem)
    start = (stem if parts is None else parts.start).rstrip(_SEPARATORS)
    return start or "sequence"


def sequence_name(pattern: str) -> str:
    """The name of the one file that a sequence counts as: ``plate.exr`` of ``plate.%04d.exr``."""
    parts = _parts(pattern)
    return base_name(pattern) + parts.end if parts else pattern


def _parts(pattern: str) -> _Parts | None:
    """The parts of a pattern; None if it has no placeholder."""
    matches = list(_PLACEHOLDER.finditer(pattern))
    if not matches:
        return None
    last = matches[-1]
    digits = len(last[2] or "") or int(last[1] or 1)
    return _Parts(pattern[: last.start()], digits, pattern[last.end() :])
