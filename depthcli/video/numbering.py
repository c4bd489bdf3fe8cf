"""Numbered images: their names, and those of a folder or a pattern such as ``plate.%04d.exr``.

So is ``plate.####.exr``, the notation of compositing programs. It is free of NumPy, for start-up.
"""

import os
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path, PurePath
from typing import NamedTuple

from depthcli.errors import InputError, UsageError, os_errors_as
from depthcli.io import guard, media
from depthcli.io.formats.table import READABLE_SUFFIXES
from depthcli.io.storage.paths import RemotePath, path_of

_NUMBER = re.compile(r"\d+", re.ASCII)
_LAST_NUMBER = re.compile(r"(.*?)(\d+)(\D*)", re.ASCII)
# Seconds since 1970 with decimals, as of TUM, or nanoseconds without leading zeros, as of ROS.
_SECONDS = re.compile(r"(?<!\d)(1\d{9})([._])(\d{1,9})$", re.ASCII)
_NANOSECONDS, _DECIMALS = 8, 5  # digits of most; shorter ones may be numbers of frames
# Before a digit, as in "take #2", # is no placeholder.
_PLACEHOLDER = re.compile(r"%(?:0(\d))?d|(#+)(?![#\d])", re.ASCII)
_SEPARATORS = "._- "
_TIME_STEP, _LEAST_TIME = 1000, 100_000  # microseconds of 10 to 30 images a second are far above
_MILLISECONDS = 10**12  # since 1970, of the year 2001


def is_pattern(name: str) -> bool:
    """Whether a name has exactly one placeholder for a number."""
    return len(_PLACEHOLDER.findall(name)) == 1


def is_sequence(path: str | Path) -> bool:
    """Whether a name stands for numbered images: a folder, or a pattern that is no file."""
    path = path_of(path)
    with os_errors_as(InputError, f"{path} cannot be read"):
        return path.is_dir() or (is_pattern(path.name) and not path.exists())


def numbered_name(pattern: str, number: int) -> str:
    """The name of the file with a number."""
    start, digits, end = _parts(pattern)
    return f"{start}{number:0{digits}d}{end}" if digits else pattern


def number_in(pattern: str, name: str) -> int | None:
    """The number in a name; None if the name does not match the pattern."""
    start, _, end = _parts(pattern)
    number = name[len(start) : len(name) - len(end)]
    is_number = number.isdecimal() and numbered_name(pattern, int(number)) == name
    return int(number) if is_number and name != pattern else None


def times_ns(stems: Sequence[str]) -> list[int]:
    """Nanoseconds since 1970 that names without suffix end in; none if not all do."""
    times = [time.groups() for time in map(_SECONDS.search, stems) if time]
    longest = max((len(part) for _, _, part in times), default=0)
    has_nanoseconds = longest >= _NANOSECONDS
    is_time = has_nanoseconds or (longest >= _DECIMALS and {mark for _, mark, _ in times} == {"."})
    if len(times) < len(stems) or not is_time:
        return []
    return [int(s + (p.zfill(9) if has_nanoseconds else p.ljust(9, "0"))) for s, _, p in times]


def base_name(stem: str) -> str:
    """The name of a sequence: ``plate`` of ``plate.%04d``."""
    return _parts(stem)[0].rstrip(_SEPARATORS) or "sequence"


def sequence_name(pattern: str) -> str:
    """The name of the one file that a sequence counts as: ``plate.exr`` of ``plate.%04d.exr``."""
    _, digits, end = _parts(pattern)
    return base_name(pattern) + end if digits else pattern


def _parts(pattern: str) -> tuple[str, int, str]:
    """Text before the last placeholder, least number of digits, and text after; 0 without one."""
    matches = list(_PLACEHOLDER.finditer(pattern))
    if not matches:
        return pattern, 0, ""
    last = matches[-1]
    digits = len(last[2] or "") or int(last[1] or 1)
    return pattern[: last.start()], digits, pattern[last.end() :]


class NumberedImage(NamedTuple):
    """An image of a sequence."""

    number: int  #: of the frame
    path: Path  #: the file


def find_images(path: Path, *, is_depth: bool = False) -> list[NumberedImage]:
    """The images of a sequence, in their order.

    Those that match a pattern, or all of a folder, except outputs of depthcli. In a folder, the
    names differ in the number of the frame alone. Images without such numbers are counted from 0,
    in the order of their names. UsageError if a folder holds several sequences. With ``is_depth``,
    they are depth files, of depthcli as well.
    """
    is_folder = not is_pattern(path.name) or path.is_dir()
    folder = path if is_folder else path.parent
    with os_errors_as(InputError, f"{folder} cannot be listed"):
        names = listed_names(folder)
        if not is_folder:
            names = (name for name in names if number_in(path.name, name) is not None)
        elif is_depth:
            names = (n for n in names if PurePath(n).suffix.lower() in READABLE_SUFFIXES)
        else:
            names = (name for name in names if media.is_image(name) or media.is_exr(name))
        matching = [folder / name for name in names if not (is_folder and name.startswith("."))]
    if not matching:
        what = "no image" if is_folder else "no such image: nothing fits the pattern"
        raise InputError(f"{path} has {what}", "see docs/video.md for image sequences")
    paths = [file for file in matching if is_depth or not guard.is_own_image(file)]
    if not paths:
        problem = f"{matching[0]} was written by depthcli, as was all of {path}"
        raise InputError(problem, "name the images that it was made of")
    if is_folder:
        return _of_folder(folder, paths)
    return sorted(NumberedImage(number_in(path.name, file.name) or 0, file) for file in paths)


def are_times(images: Sequence[NumberedImage]) -> bool:
    """Whether the numbers of images, in their order, are time stamps, as data sets have them.

    No two are closer than a thousand, or they are as large as those in milliseconds and none is
    followed by the next number; numbers of plates are not so large.
    """
    step, last = min((b.number - a.number for a, b in pairwise(images)), default=0), images[-1]
    is_fine = step >= _TIME_STEP and last.number >= _LEAST_TIME
    return is_fine or (step > 1 and last.number >= _MILLISECONDS)


def listed_names(folder: Path) -> Iterable[str]:
    """The names in a folder, in the order of their characters; OSError if it has no list."""
    if isinstance(folder, RemotePath):
        names = () if folder.is_http else folder.walk_names()
        return (name for name in names if "/" not in name)
    return sorted(os.listdir(folder))  # noqa: PTH208 - names, sorted as such


def _of_folder(folder: Path, paths: Sequence[Path]) -> list[NumberedImage]:
    """The one sequence of a folder, or images without frame numbers, counted from 0."""
    times = times_ns([path.stem for path in paths])
    if len(set(times)) == len(paths):
        return sorted(map(NumberedImage, times, paths))
    texts = {(*_NUMBER.split(path.stem), path.suffix.lower()) for path in paths}
    if len(texts) == 1:
        columns = list(zip(*(_NUMBER.findall(path.stem) for path in paths), strict=True))
        varying = [column for column in columns if len(set(column)) > 1] or columns[-1:]
        if len(varying) == 1 and len(set(map(int, varying[0]))) == len(paths):
            return sorted(map(NumberedImage, map(int, varying[0]), paths))
    groups: dict[tuple[str, str, str], list[NumberedImage]] = {}
    for path in paths:
        if match := _LAST_NUMBER.fullmatch(path.stem):
            key = match[1], match[3], path.suffix.lower()
            groups.setdefault(key, []).append(NumberedImage(int(match[2]), path))
    sequences = [sorted(group) for group in groups.values() if len(group) > 1]
    # Names of one form without consecutive numbers are times, such as 12-30-05.16.
    steps = (min(b.number - a.number for a, b in pairwise(sequence)) for sequence in sequences)
    if not sequences or (len(texts) == 1 and all(step > 1 for step in steps)):
        return [NumberedImage(number, path) for number, path in enumerate(paths)]
    firsts = " and ".join(sequence[0].path.name for sequence in sequences[:2])
    problem = f"{folder} holds more than a single image sequence, those of {firsts} for example"
    raise UsageError(problem, "give one as a pattern such as plate.####.png")
