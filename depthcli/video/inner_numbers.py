"""Frame numbers before other numbers of a name: 1001 of ``plate.1001.v003``."""

import re
from collections.abc import Sequence

from depthcli.video.number_pattern import MAX_DIGITS

_NUMBER = re.compile(r"(\d+)", re.ASCII)
_LETTER = re.compile(r"[^\W\d_]")
_MAX_NUMBER = 9_999_999
"""Larger numbers before others are dates, such as 20240131, or seconds of a clock."""


def inner_numbers(stems: Sequence[str]) -> list[int] | None:
    """The frame's number in each of several names; None if it is not certain which one it is.

    Names without suffix. They have the same text between their numbers, and differ in one number,
    by its value. Names without letters are taken as dates and times, such as ``12-00-01``.
    """
    names = [_NUMBER.split(stem) for stem in stems]  # text, number, text, ..., text
    texts = {tuple(name[::2]) for name in names}
    if len(texts) != 1 or not any(map(_LETTER.search, *texts)):
        return None
    columns = zip(*(name[1::2] for name in names), strict=True)
    varying = [column for column in columns if len(set(column)) > 1]
    if len(varying) != 1 or any(len(digits) > MAX_DIGITS for digits in varying[0]):
        return None
    numbers = [int(digits) for digits in varying[0]]
    is_distinct = len(set(numbers)) == len(numbers)
    return numbers if is_distinct and max(numbers) <= _MAX_NUMBER else None
