"""Numbered images as a video, read one after the other."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

from depthcli.core.options import AS_STATED, MAX_PIXELS, ReadOptions
from depthcli.core.types import Frame, Window
from depthcli.errors import InputError, Message, about
from depthcli.io.exr.image import read_exr_image
from depthcli.io.images.read import read_image
from depthcli.io.media import is_exr
from depthcli.video.frames import FALLBACK_RATE, WHOLE, FrameSource, Span, exact_rate
from depthcli.video.numbering import NumberedImage, are_times, find_images

_SHOWN = 10
_TRIES = 10  #: images that are asked for their frame rate
_CUT = "images with more overscan than the first one, which is cut off"


class ImageSequence(FrameSource):
    """Numbered images, read one after the other."""

    numbers_follow_times = True

    def __init__(
        self,
        path: Path,
        *,
        rate: Fraction | None = None,
        max_pixels: int = MAX_PIXELS,
        options: ReadOptions = AS_STATED,
    ) -> None:
        """Find the images of a folder or of a pattern such as ``%04d``.

        ``rate`` is frames a second; None for that of the first EXR. Larger images than
        ``max_pixels`` are refused. InputError if there is none, UsageError if the folder holds
        more than one sequence.
        """
        files = find_images(path)
        self.paths = tuple(file.path for file in files)
        if are_times(files):
            self.name_numbers = [file.number for file in files]
            files = list(map(NumberedImage, range(len(files)), self.paths))
        self._files = files
        self._max_pixels, self._options = max_pixels, options
        self._overscan: Window | None = None  # that of the first image
        file_rate = rate or stated_rate(self.paths)
        self.rate = file_rate or FALLBACK_RATE
        self.tick_s = Fraction(1, self.rate.numerator)
        self.frames_stated = len(self._files)
        self.warnings = tuple(self._warnings(is_timed=file_rate is not None))

    @property
    def numbers_stated(self) -> tuple[int, int]:
        """Number of the first and of the last image."""
        return self._files[0].number, self._files[-1].number

    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """Read the images of a span; ``index`` is the number in the name."""
        cut, warnings, sizes_px = 0, self.warnings, None
        for frame in self._readable(span):
            found_px = (frame.width, frame.height), frame.display_size_px
            if sizes_px is None:
                sizes_px, self._overscan = found_px, _overscan(frame)
                warnings += tuple(about(str(frame.path), warning) for warning in frame.warnings)
                self.warnings = warnings
            if found_px != sizes_px:
                self.problem = f"{frame.path} has another size; the images before it are done"
                return
            if frame.windows and frame.windows.valid != frame.windows.data:
                cut += 1
                self.warnings = (*warnings, f"{_CUT}: {cut}, the last of them: {frame.path}")
            yield frame

    def _readable(self, span: Span) -> Iterator[Frame]:
        """The images of a span that can be read."""
        unreadable = list[int]()
        for file, is_wanted in zip(self._files, self._selected(span), strict=False):
            try:
                if is_wanted:
                    yield self._read(file)
            except InputError as error:
                unreadable.append(file.number)
                problem = f"{len(unreadable)} of its images cannot be read ({_listed(unreadable)})"
                self.problem = f"{problem}, the last of them: {error}"

    def _selected(self, span: Span) -> Iterator[bool]:
        """Whether each image is in a span."""
        return span.selected((file.number, self._time_s(file)) for file in self._files)

    def count(self, span: Span) -> int:
        """Number of images in a span."""
        return sum(self._selected(span))

    def _time_s(self, file: NumberedImage) -> Fraction:
        return (file.number - self._files[0].number) / self.rate

    def _read(self, file: NumberedImage) -> Frame:
        limit, options = self._max_pixels, self._options
        if is_exr(file.path.name):
            overscan = self._overscan
            image = read_exr_image(file.path, max_pixels=limit, overscan=overscan, options=options)
        else:
            image = read_image(file.path, max_pixels=limit, **options._asdict())
        return replace(image, index=file.number, timestamp_s=float(self._time_s(file)))

    def _warnings(self, *, is_timed: bool) -> Iterator[str]:
        if not is_timed:
            yield Message(f"no frame rate is given; {FALLBACK_RATE} is assumed", "give {fps}")
        if self.name_numbers:
            yield f"numbers such as {self.paths[0].stem} are times; frames are counted from 0"
        ends = [(a + 1, b - 1) for a, b in pairwise(file.number for file in self._files)]
        gaps = [f"{a}" if a == b else f"{a}–{b}" for a, b in ends if a <= b]
        if gaps:
            yield f"missing frames: {_listed(gaps)}; the other frames keep their times"


def stated_rate(paths: Sequence[Path]) -> Fraction | None:
    """The frame rate of the first EXR that can be read, exact; None if none."""
    for path in (path for path in paths[:_TRIES] if is_exr(path.name)):
        from depthcli.io.exr.file import read_exr_rate  # noqa: PLC0415 - OpenEXR is slow to load

        with suppress(InputError):  # which reading its pixels reports
            rate = read_exr_rate(path)
            return rate and (exact_rate(rate) or rate)
    return None


def _listed(numbers: Sequence[object]) -> str:
    """The first of several numbers, in a message."""
    more = f" and {len(numbers) - _SHOWN} more" if len(numbers) > _SHOWN else ""
    return ", ".join(map(str, numbers[:_SHOWN])) + more


def _overscan(frame: Frame) -> Window:
    """The window of a frame's pixels, relative to the corner of its display window."""
    if frame.windows is None:
        return Window(0, 0, frame.width, frame.height)
    left, top = frame.windows.display[:2]
    return frame.windows.pixels.moved(-left, -top)
