"""Numeric ids as ranges: ``0000-0002,0007``."""

from collections.abc import Iterable
from itertools import pairwise

_DIGITS = 4


def compact(ids: Iterable[str]) -> str:
    """Format ids, whole numbers as in NYU Depth v2, as ranges.

    >>> compact(["0001", "0000", "0002", "0007"])
    '0000-0002,0007'
    """
    numbers = sorted({int(name) for name in ids})
    if not numbers:
        return ""
    breaks = [(a, b) for a, b in pairwise(numbers) if b != a + 1]
    firsts = [numbers[0], *(b for _, b in breaks)]
    lasts = [*(a for a, _ in breaks), numbers[-1]]
    return ",".join(_range_text(a, b) for a, b in zip(firsts, lasts, strict=True))


def _range_text(first: int, last: int) -> str:
    start = f"{first:0{_DIGITS}d}"
    return start if first == last else f"{start}-{last:0{_DIGITS}d}"


def parse(text: str) -> frozenset[int]:
    """Parse ranges of ids to numbers.

    Raises:
        ValueError: the text is not a list of ranges.

    >>> sorted(parse("0000-0002,0007"))
    [0, 1, 2, 7]
    """
    numbers: set[int] = set()
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        numbers.update(range(int(first), int(last or first) + 1))
    return frozenset(numbers)
