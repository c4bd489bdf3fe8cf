"""Numbered pictures as a video: ``plate.%04d.exr``, or a folder in the order of its names."""

from __future__ import annotations

import os
import re
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, Self

from depthcli.core.types import Frame
from depthcli.errors import InputError
from depthcli.io.exr_pictures import read_exr_picture, read_exr_rate
from depthcli.io.listing.folder import PICTURE_SUFFIXES
from depthcli.io.listing.own_outputs import is_own_output
from depthcli.io.pictures.decode import MAX_PIXELS
from depthcli.io.pictures.read import read_image
from depthcli.io.video.number_pattern import NUMBER, is_pattern, numbered
from depthcli.io.video.rates import rate_text
from depthcli.io.video.spans import WHOLE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

    from depthcli.core.picture_limit import PictureLimit
    from depthcli.io.video.spans import Span

FALLBACK_RATE = Fraction(25)
_EXR = ".exr"
_LAST_NUMBER = re.compile(r"(.*?)(\d+)\D*", re.ASCII)


class Numbered(NamedTuple):
    """A picture of a sequence.

    Attributes:
        number: of the frame.
        path: the file.
    """

    number: int
    path: Path


class ImageSequence:
    """Numbered pictures, read one after the other.

    Attributes:
        path: the pattern or the folder.
        files: the pictures in their order.
        rate: frames a second.
        tick_s: seconds of which every frame's time is a multiple.
        frames_stated: how many pictures there are.
        width: columns of an upright frame.
        height: rows of an upright frame.
        warnings: one-line texts.
        problem: why frames are missing, once the others have been read; None if all came.
        start_s: None, for pictures have no sound.
    """

    def __init__(
        self,
        path: Path,
        *,
        rate: Fraction | None = None,
        max_pixels: int | PictureLimit = MAX_PIXELS,
    ) -> None:
        """Find the pictures, and read the first one.

        Args:
            path: a pattern with ``%04d`` or the like in its name, or a folder.
            rate: frames a second; None for what the first EXR states.
            max_pixels: pictures that claim more are refused.

        Raises:
            InputError: there is none, or the first cannot be read.
        """
        self.path = path
        self.files = find_pictures(path)
        self._max_pixels = max_pixels
        stated = rate or read_exr_rate(self.files[0].path)
        self.rate = stated or FALLBACK_RATE
        first = self._read(self.files[0])
        self.width, self.height = first.width, first.height
        self.tick_s = Fraction(1, self.rate.numerator)
        self.frames_stated: int | None = len(self.files)
        self.start_s = None
        self.problem: str | None = None
        self.warnings = tuple(self._doubts(is_timed=stated is not None))

    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """Read the frames of a span.

        Yields:
            (H, W) gray or (H, W, 3) RGB; uint8, uint16, or float32 of EXR; ``index`` is the number
            in the file's name, and ``timestamp_s`` counts from the first picture of all.
        """
        first = self.files[0].number
        lost = 0
        times = ((file.number, (file.number - first) / self.rate) for file in self.files)
        for file, is_wanted in zip(self.files, span.picks(times), strict=False):
            if not is_wanted:
                continue
            try:
                frame = self._read(file)
            except InputError as error:
                lost += 1
                self.problem = f"{lost} of its pictures cannot be read, the last of them: {error}"
                continue
            if (frame.width, frame.height) != (self.width, self.height):
                self.problem = f"{file.path} has another size; the pictures before it are done"
                return
            yield frame

    def close(self) -> None:
        """Do nothing; there is no file open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _read(self, file: Numbered) -> Frame:
        if file.path.suffix.lower() == _EXR:
            picture = Frame(read_exr_picture(file.path, max_pixels=self._max_pixels), file.path)
        else:
            picture = read_image(file.path, max_pixels=self._max_pixels)
        time_s = float((file.number - self.files[0].number) / self.rate)
        return Frame(
            picture.pixels,
            file.path,
            file.number,
            time_s,
            orientation=picture.orientation,
            focal_35mm=picture.focal_35mm,
        )

    def _doubts(self, *, is_timed: bool) -> Iterator[str]:
        if not is_timed:
            yield f"no frame rate is given; {rate_text(FALLBACK_RATE)} is assumed, or give --fps"
        missing = self.files[-1].number - self.files[0].number + 1 - len(self.files)
        if missing:
            yield f"{missing} numbers of the sequence are missing; the others keep their times"


def find_pictures(path: Path) -> list[Numbered]:
    """The pictures of a sequence, in their order.

    Args:
        path: a pattern, or a folder whose pictures are taken in the order of their names, but for
            what depthcli wrote. Their last number counts if it grows; else they count from 0.

    Raises:
        InputError: there is no such folder, or nothing in it.
    """
    folder = path.parent if is_pattern(path.name) else path
    try:
        names = sorted(os.listdir(folder))  # noqa: PTH208 - names, sorted as such
    except OSError as error:
        raise InputError(f"{folder} cannot be listed: {error.strerror}") from None
    if folder is path:
        found = _by_name(folder, names)
    else:
        found = sorted(
            Numbered(number, folder / name)
            for name in names
            if (number := numbered(path.name, name)) is not None
        )
    if not found:
        what = "no picture" if folder is path else "no such picture: nothing fits the pattern"
        raise InputError(f"{path} has {what}; see docs/video.md for image sequences")
    return found


def _by_name(folder: Path, names: list[str]) -> list[Numbered]:
    paths = [
        folder / name
        for name in names
        if not name.startswith(".")
        and os.path.splitext(name)[1].lower() in (*PICTURE_SUFFIXES, _EXR)  # noqa: PTH122
        and not is_own_output(str(folder / name))
    ]
    matches = [_LAST_NUMBER.fullmatch(path.stem) for path in paths]
    numbers = [int(match[2]) for match in matches if match and len(match[2]) <= NUMBER]
    grows = len(numbers) == len(paths) and all(a < b for a, b in pairwise(numbers))
    return [
        Numbered(number, path)
        for number, path in zip(numbers if grows else range(len(paths)), paths, strict=True)
    ]
