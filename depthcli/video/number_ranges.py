"""Numbers of frames in messages: ``1004–1006, 1010``."""

from collections.abc import Iterable
from itertools import pairwise

_MAX_SHOWN = 10


class NumberRanges:
    """Ascending numbers, which take no more memory where they are consecutive."""

    def __init__(self, ranges: Iterable[tuple[int, int]] = ()) -> None:
        """Take ranges, each by its first and its last number."""
        self._ranges = list(ranges)

    def __bool__(self) -> bool:
        return bool(self._ranges)

    def __len__(self) -> int:
        """How many numbers there are."""
        return sum(last - first + 1 for first, last in self._ranges)

    def __str__(self) -> str:
        """The first ranges, and how many numbers the others have."""
        shown = ", ".join(map(_first_to_last, self._ranges[:_MAX_SHOWN]))
        more = len(NumberRanges(self._ranges[_MAX_SHOWN:]))
        return f"{shown} and {more} more" if more else shown

    def append(self, number: int) -> None:
        """Add a number that is larger than all others."""
        if self._ranges and self._ranges[-1][1] == number - 1:
            self._ranges[-1] = self._ranges[-1][0], number
        else:
            self._ranges.append((number, number))


def missing_numbers(numbers: Iterable[int]) -> NumberRanges:
    """The numbers between the first and the last of ascending ones that are not among them."""
    return NumberRanges((a + 1, b - 1) for a, b in pairwise(numbers) if b - a > 1)


def _first_to_last(numbers: tuple[int, int]) -> str:
    first, last = numbers
    return str(first) if first == last else f"{first}–{last}"
