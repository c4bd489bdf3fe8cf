"""The files of an image sequence, in their order."""

import os
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import InputError, UsageError
from depthcli.io.listing.folder import is_exr, is_picture
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.remote import RemotePath
from depthcli.video.number_pattern import (
    LAST_NUMBER,
    is_pattern,
    number_in,
    pattern_of,
)

_NUMBER = re.compile(r"\d+", re.ASCII)
_LISTED = 4
"""Most patterns that an error lists."""


class NumberedPicture(NamedTuple):
    """A picture of a sequence."""

    number: int  #: of the frame
    path: Path  #: the file


def find_pictures(path: Path) -> list[NumberedPicture]:
    """The pictures of a sequence, in their order.

    Those that match a pattern, or all of a folder, except outputs of depthcli. In a folder, the
    names differ in the number of the frame alone. Pictures without such numbers are counted from 0,
    in the order of their names.

    Raises:
        InputError: there is no such folder, or no picture in it, or depthcli wrote all of them.
        UsageError: a folder holds several sequences, or other pictures beside one.
    """
    is_folder = not is_pattern(path.name) or path.is_dir()
    folder = path if is_folder else path.parent
    try:
        names = list(listed_names(folder))
    except OSError as error:
        raise InputError(f"{folder} cannot be listed: {error.strerror}") from None
    matching = [
        folder / name
        for name in names
        if (is_sequence_picture(name) if is_folder else number_in(path.name, name) is not None)
    ]
    if not matching:
        what = "no picture" if is_folder else "no such picture: nothing fits the pattern"
        raise InputError(f"{path} has {what}; see docs/video.md for image sequences")
    paths = [file for file in matching if not is_own_picture(file)]
    if not paths:
        raise InputError(
            f"{matching[0]} was written by depthcli, as was all of {path}; name the pictures that "
            "it was made of ('depthcli convert' converts depth files, but not to a video)"
        )
    if is_folder:
        return _of_folder(folder, paths)
    return sorted(
        NumberedPicture(number, file)
        for file in paths
        if (number := number_in(path.name, file.name)) is not None
    )


def listed_names(folder: Path) -> Iterable[str]:
    """The names in a folder, in the order of their characters.

    Raises:
        OSError: the folder cannot be listed.
    """
    if isinstance(folder, RemotePath):
        return folder.names()
    return sorted(os.listdir(folder))  # noqa: PTH208 - names, sorted as such


def is_sequence_picture(name: str) -> bool:
    """Whether a name is that of a picture, EXR included, by its suffix, and not hidden."""
    return not name.startswith(".") and (is_picture(name) or is_exr(name))


def _of_folder(folder: Path, paths: Sequence[Path]) -> list[NumberedPicture]:
    """The one sequence of a folder, or pictures without frame numbers, counted from 0."""
    texts = {(*_NUMBER.split(path.stem), path.suffix.lower()) for path in paths}
    if len(texts) == 1:
        columns = list(zip(*(_NUMBER.findall(path.stem) for path in paths), strict=True))
        varying = [column for column in columns if len(set(column)) > 1] or columns[-1:]
        if len(varying) == 1 and len(set(map(int, varying[0]))) == len(paths):
            return sorted(map(NumberedPicture, map(int, varying[0]), paths))
    groups: dict[tuple[str, str, str], list[NumberedPicture]] = {}
    for path in paths:
        match = LAST_NUMBER.fullmatch(path.stem)
        if match:
            key = match[1], match[3], path.suffix.lower()
            groups.setdefault(key, []).append(NumberedPicture(int(match[2]), path))
    sequences = [sorted(group) for group in groups.values() if len(group) > 1]
    # Names of one form without consecutive numbers are times, such as 1305031102.16.
    has_times = len(texts) == 1 and all(_least_step(sequence) > 1 for sequence in sequences)
    if not sequences or has_times:
        return [NumberedPicture(number, path) for number, path in enumerate(paths)]
    patterns = ", ".join(map(_pattern_text, sequences[:_LISTED]))
    more = f" and {len(sequences) - _LISTED} more" if len(sequences) > _LISTED else ""
    raise UsageError(
        f"{folder} holds more than a single image sequence",
        f"give one as a pattern: {patterns}{more}",
    )


def _least_step(sequence: Sequence[NumberedPicture]) -> int:
    """The smallest difference of consecutive numbers, in frames; 0 if a number is repeated."""
    return min((b.number - a.number for a, b in pairwise(sequence)), default=1)


def _pattern_text(sequence: Sequence[NumberedPicture]) -> str:
    """A pattern of the files, in quotes; the name of the first if there is none."""
    path = min((picture.path for picture in sequence), key=lambda path: len(path.name))
    return f"'{path.with_name((pattern_of(path.stem) or path.stem) + path.suffix)}'"
