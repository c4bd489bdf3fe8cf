"""Patterns for the names of numbered files: ``plate.%04d.exr`` matches ``plate.1001.exr``.

So does ``plate.####.exr``, the notation of compositing programs.
"""

import re

MAX_DIGITS = 12
"""Most digits of a frame's number."""
LAST_NUMBER = re.compile(r"(.*?)(\d+)(\D*)", re.ASCII)
"""The parts of a name without suffix: before its last number, that number, and after it."""
_SHORT = 4
"""Numbers with fewer digits and no leading zero are taken as not padded."""
_PLACEHOLDER = re.compile(r"%(?:0(\d))?d|(##+)", re.ASCII)
_SEPARATORS = "._- "


def is_pattern(name: str) -> bool:
    """Whether a name has exactly one placeholder for a number."""
    return len(_PLACEHOLDER.findall(name)) == 1


def numbered_name(pattern: str, number: int) -> str:
    """The name of the file with a number."""
    return _PLACEHOLDER.sub(
        lambda found: f"{number:0{len(found[2] or '') or int(found[1] or 1)}d}", pattern, count=1
    )


def number_in(pattern: str, name: str) -> int | None:
    """The number in a name; None if the name does not match the pattern."""
    placeholder = _PLACEHOLDER.search(pattern)
    if placeholder is None:
        return None
    start, end = pattern[: placeholder.start()], pattern[placeholder.end() :]
    digits = name[len(start) : len(name) - len(end)]
    fits = name.startswith(start) and name.endswith(end) and digits.isascii() and digits.isdigit()
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
    start = _PLACEHOLDER.split(stem)[0].rstrip(_SEPARATORS)
    return start or "sequence"
