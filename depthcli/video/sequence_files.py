"""The files of an image sequence, in their order."""

import os
import re
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import InputError
from depthcli.io.listing.folder import PICTURE_SUFFIXES
from depthcli.io.listing.own_outputs import is_own_output
from depthcli.io.storage.remote import RemotePath
from depthcli.video.number_pattern import MAX_DIGITS, is_pattern, number_in

EXR = ".exr"
_LAST_NUMBER = re.compile(r"(.*?)(\d+)\D*", re.ASCII)


class NumberedPicture(NamedTuple):
    """A picture of a sequence."""

    number: int  #: of the frame
    path: Path  #: the file


def find_pictures(path: Path) -> list[NumberedPicture]:
    """The pictures of a sequence, in their order.

    Those that match a pattern, or all of a folder by name except outputs of depthcli. Frame numbers
    in a folder are the last numbers in the names if these increase, else they count from 0.

    Raises:
        InputError: there is no such folder, or nothing in it.
    """
    folder = path.parent if is_pattern(path.name) else path
    try:
        if isinstance(folder, RemotePath):
            names = sorted(folder.names_after(""))
        else:
            names = sorted(os.listdir(folder))  # noqa: PTH208 - names, sorted as such
    except OSError as error:
        raise InputError(f"{folder} cannot be listed: {error.strerror}") from None
    if folder is path:
        found = _by_name(folder, names)
    else:
        found = sorted(
            NumberedPicture(number, folder / name)
            for name in names
            if (number := number_in(path.name, name)) is not None
        )
    if not found:
        what = "no picture" if folder is path else "no such picture: nothing fits the pattern"
        raise InputError(f"{path} has {what}; see docs/video.md for image sequences")
    return found


def _by_name(folder: Path, names: list[str]) -> list[NumberedPicture]:
    paths = [
        folder / name
        for name in names
        if not name.startswith(".")
        and os.path.splitext(name)[1].lower() in (*PICTURE_SUFFIXES, EXR)  # noqa: PTH122
        and not is_own_output(str(folder / name))
    ]
    matches = [_LAST_NUMBER.fullmatch(path.stem) for path in paths]
    numbers = [int(match[2]) for match in matches if match and len(match[2]) <= MAX_DIGITS]
    grows = len(numbers) == len(paths) and all(a < b for a, b in pairwise(numbers))
    return [
        NumberedPicture(number, path)
        for number, path in zip(numbers if grows else range(len(paths)), paths, strict=True)
    ]
