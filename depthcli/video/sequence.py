"""Numbered pictures as a video: ``plate.%04d.exr``, or a folder in the order of its names."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from depthcli.core.options import AS_STATED, MAX_PIXELS, ReadOptions
from depthcli.core.types import Frame, Window
from depthcli.errors import InputError, Message, UsageError, about
from depthcli.io.exr.image import read_exr_picture, read_exr_rate
from depthcli.io.images.read import read_image
from depthcli.io.listing.folder import is_exr, is_picture
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.paths import RemotePath
from depthcli.video.frames import FALLBACK_RATE, WHOLE, FrameSource, Span, exact_rate
from depthcli.video.numbering import LAST_NUMBER, is_pattern, number_in, pattern_of

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


_SHOWN = 10
_TRIES = 10
"""How many pictures may be unreadable before there is one that can be read."""
_CUT = "pictures with more overscan than the first one, which is cut off"


class ImageSequence(FrameSource):
    """Numbered pictures, read one after the other."""

    numbers_follow_times = True

    def __init__(
        self,
        path: Path,
        *,
        rate: Fraction | None = None,
        max_pixels: int = MAX_PIXELS,
        options: ReadOptions = AS_STATED,
    ) -> None:
        """Find the pictures of a folder or of a pattern such as ``%04d``.

        Args:
            path: the folder or the pattern.
            rate: frames a second; None for that of the first EXR.
            max_pixels: larger pictures are refused.
            options: for reading the pictures.

        Raises:
            InputError: there is none.
            UsageError: the folder holds more than one sequence.
        """
        self._files = find_pictures(path)
        self.paths = tuple(file.path for file in self._files)
        self._max_pixels, self._options = max_pixels, options
        self._overscan: Window | None = None  # that of the first picture
        stated = rate or _stated_rate(self.paths)
        self.rate = stated or FALLBACK_RATE
        self.tick_s = Fraction(1, self.rate.numerator)
        self.frames_stated = len(self._files)
        self.warnings = tuple(self._warnings(is_timed=stated is not None))

    @property
    def numbers_stated(self) -> tuple[int, int]:
        """Number of the first and of the last picture."""
        return self._files[0].number, self._files[-1].number

    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """Read the frames of a span.

        Yields:
            (H, W) gray or (H, W, 3) RGB; uint8, uint16, or float32 of EXR; ``index`` is the number
            in the file's name, and ``timestamp_s`` counts from the first picture of all.
        """
        cut, told, sizes_px = 0, self.warnings, None
        for frame in self._readable(span):
            found_px = (frame.width, frame.height), frame.display_size_px
            if sizes_px is None:
                sizes_px, self._overscan = found_px, _overscan(frame)
                told += tuple(about(str(frame.path), warning) for warning in frame.warnings)
                self.warnings = told
            if found_px != sizes_px:
                self.problem = f"{frame.path} has another size; the pictures before it are done"
                return
            if frame.windows and frame.windows.valid != frame.windows.data:
                cut += 1
                self.warnings = (*told, f"{_CUT}: {cut}, the last of them: {frame.path}")
            yield frame

    def _readable(self, span: Span) -> Iterator[Frame]:
        """The pictures of a span that can be read."""
        read, unreadable = 0, list[int]()
        wanted = span.selected(self._numbers_and_times())
        for file, is_wanted in zip(self._files, wanted, strict=False):
            if not is_wanted or (not read and len(unreadable) == _TRIES):
                continue
            try:
                frame = self._read(file)
            except InputError as error:
                unreadable.append(file.number)
                self.problem = (
                    f"{len(unreadable)} of its pictures cannot be read "
                    f"({_listed(unreadable)}), the last of them: {error}"
                )
            else:
                read += 1
                yield frame

    def count(self, span: Span) -> int:
        """How many pictures a span has."""
        return sum(span.selected(self._numbers_and_times()))

    def _numbers_and_times(self) -> Iterator[tuple[int, Fraction]]:
        """Number and time of each picture."""
        return ((file.number, self._time_s(file)) for file in self._files)

    def _time_s(self, file: NumberedPicture) -> Fraction:
        return (file.number - self._files[0].number) / self.rate

    def _read(self, file: NumberedPicture) -> Frame:
        if is_exr(file.path.name):
            picture = read_exr_picture(
                file.path,
                max_pixels=self._max_pixels,
                overscan=self._overscan,
                options=self._options,
            )
        else:
            picture = read_image(file.path, max_pixels=self._max_pixels, **self._options._asdict())
        return replace(picture, index=file.number, timestamp_s=float(self._time_s(file)))

    def _warnings(self, *, is_timed: bool) -> Iterator[str]:
        if not is_timed:
            yield Message(f"no frame rate is given; {FALLBACK_RATE} is assumed", "give {fps}")
        ends = [(a + 1, b - 1) for a, b in pairwise(file.number for file in self._files)]
        gaps = [f"{a}" if a == b else f"{a}–{b}" for a, b in ends if a <= b]
        if gaps:
            yield f"missing frames: {_listed(gaps)}; the other frames keep their times"


def _stated_rate(paths: Sequence[Path]) -> Fraction | None:
    """The frame rate of the first EXR that can be read, as ``--fps`` takes it; None if none."""
    for path in paths[:_TRIES]:
        with suppress(InputError):  # which reading its pixels reports
            rate = read_exr_rate(path)
            return rate and (exact_rate(rate) or rate)
    return None


def _listed(numbers: Sequence[object]) -> str:
    """The first of several numbers, in a message."""
    more = f" and {len(numbers) - _SHOWN} more" if len(numbers) > _SHOWN else ""
    return ", ".join(map(str, numbers[:_SHOWN])) + more


def _overscan(frame: Frame) -> Window:
    """What its pixels cover, relative to the corner of the display window."""
    if frame.windows is None:
        return Window(0, 0, frame.width, frame.height)
    left, top = frame.windows.display[:2]
    return frame.windows.pixels.moved(-left, -top)
