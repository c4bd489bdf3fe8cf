"""The files of an image sequence, in their order."""

import os
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import InputError
from depthcli.io.listing.folder import is_exr, is_picture
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.remote import RemotePath
from depthcli.video.number_pattern import LAST_NUMBER, MAX_DIGITS, is_pattern, number_in

EXR = ".exr"


class NumberedPicture(NamedTuple):
    """A picture of a sequence."""

    number: int  #: of the frame
    path: Path  #: the file


def find_pictures(path: Path) -> list[NumberedPicture]:
    """The pictures of a sequence, in their order.

    Those that match a pattern, or all of a folder, except outputs of depthcli. In a folder they are
    sorted by number if their names differ in their last numbers alone, else by name. Frame numbers
    there are the last numbers in the names if these increase, else they count from 0.

    Raises:
        InputError: there is no such folder, or no picture in it, or depthcli wrote all of them.
    """
    is_folder = not is_pattern(path.name) or path.is_dir()
    folder = path if is_folder else path.parent
    try:
        if isinstance(folder, RemotePath):
            names = sorted(folder.names_after(""))
        else:
            names = sorted(os.listdir(folder))  # noqa: PTH208 - names, sorted as such
    except OSError as error:
        raise InputError(f"{folder} cannot be listed: {error.strerror}") from None
    matching = [
        folder / name
        for name in names
        if (_is_picture(name) if is_folder else number_in(path.name, name) is not None)
    ]
    if not matching:
        what = "no picture" if is_folder else "no such picture: nothing fits the pattern"
        raise InputError(f"{path} has {what}; see docs/video.md for image sequences")
    paths = [file for file in matching if not is_own_picture(file)]
    if not paths:
        raise InputError(
            f"{matching[0]} was written by depthcli, as was all of {path}; name pictures, or use "
            "'depthcli convert' for depth files"
        )
    if is_folder:
        return _by_name(paths)
    return sorted(
        NumberedPicture(number, file)
        for file in paths
        if (number := number_in(path.name, file.name)) is not None
    )


def _is_picture(name: str) -> bool:
    return not name.startswith(".") and (is_picture(name) or is_exr(name))


def _by_name(paths: list[Path]) -> list[NumberedPicture]:
    matches = [match for path in paths if (match := LAST_NUMBER.fullmatch(path.stem))]
    if len(matches) < len(paths):
        return _counted(paths)
    pictures = [
        NumberedPicture(int(match[2]), path) for match, path in zip(matches, paths, strict=True)
    ]
    if len({(match[1], match[3]) for match in matches}) == 1:  # by name, f10 is before f2
        pictures.sort(key=lambda picture: picture.number)
    grows = all(a.number < b.number for a, b in pairwise(pictures))
    fits = all(picture.number < 10**MAX_DIGITS for picture in pictures)
    return pictures if grows and fits else _counted([picture.path for picture in pictures])


def _counted(paths: list[Path]) -> list[NumberedPicture]:
    return [NumberedPicture(number, path) for number, path in enumerate(paths)]
