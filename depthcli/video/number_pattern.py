"""Names of numbered files: ``plate.%04d.exr`` stands for ``plate.1001.exr`` and the like.

So does ``plate.####.exr``, as compositing programs write it.
"""

import re

NUMBER = 12
"""Most digits of a frame's number."""
_PLACE = re.compile(r"%(?:0(\d))?d|(##+)", re.ASCII)
_SEPARATORS = "._- "


def is_pattern(name: str) -> bool:
    """Whether a name has exactly one place for a number."""
    return len(_PLACE.findall(name)) == 1


def number_name(pattern: str, number: int) -> str:
    """The name of the file with a number."""
    return _PLACE.sub(
        lambda place: f"{number:0{len(place[2] or '') or int(place[1] or 1)}d}", pattern, count=1
    )


def numbered(pattern: str, name: str) -> int | None:
    """The number in a name; None if the name does not fit the pattern."""
    place = _PLACE.search(pattern)
    if place is None:
        return None
    start, end = pattern[: place.start()], pattern[place.end() :]
    digits = name[len(start) : len(name) - len(end)]
    fits = name.startswith(start) and name.endswith(end) and digits.isascii() and digits.isdigit()
    if not fits or len(digits) > NUMBER or number_name(pattern, int(digits)) != name:
        return None
    return int(digits)


def without_number(stem: str) -> str:
    """What the files of a pattern have in common, ``plate`` of ``plate.%04d``."""
    start = _PLACE.split(stem)[0].rstrip(_SEPARATORS)
    return start or "sequence"
