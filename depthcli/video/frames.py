"""Sources of frames: their rates, times and time codes, and selecting a span of them."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeVar

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

    from depthcli.core.types import Frame

_Image = TypeVar("_Image")


@dataclass(frozen=True, slots=True)
class Point:
    """A time in a video, or an interval."""

    value: Fraction  #: seconds from the first frame, or a frame number from 0; not negative
    in_frames: bool = False  #: whether it is a frame number


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a video."""

    start: Point = Point(Fraction(0))  #: its first frame is the first at or after this point
    end: Point | None = None  #: frames from this point on are left out; None for the video's end
    #: interval between frames; in seconds, the first frame at or after each multiple is selected,
    #: in frames only multiples are
    every: Point = Point(Fraction(1), in_frames=True)

    def rate(self, rate: Fraction) -> Fraction:
        """Frames a second of the selection from a video of ``rate`` frames a second."""
        if self.every.in_frames:
            return rate / self.every.value
        return min(rate, 1 / self.every.value)

    def select(
        self, frames: Iterable[tuple[int, Fraction, _Image]], *, is_live: bool = False
    ) -> Iterator[tuple[int, Fraction, _Image]]:
        """The selected ones of frames, each a number, a time in seconds and an image.

        Of a live stream, the next frame is selected in place of one that was dropped.
        """
        step, is_exact = self.every.value, self.every.in_frames and not is_live
        due: Fraction | None = None
        for index, time_s, image in frames:
            if self.end is not None and _at(self.end, index, time_s) >= self.end.value:
                return
            now = _at(self.every, index, time_s)
            started = _at(self.start, index, time_s) >= self.start.value
            is_due = due is None or (now >= due and not (is_exact and (now - due) % step))
            if started and is_due:
                first = now if due is None else due
                due = first + ((now - first) // step + 1) * step
                yield index, time_s, image


WHOLE = Span()  #: every frame


def _at(point: Point, index: int, time_s: Fraction) -> Fraction:
    return Fraction(index) if point.in_frames else time_s


class FrameSource(ABC):
    """Frames in their order, one at a time in memory."""

    paths: tuple[Path, ...]  #: the files that are read; none of a pipe
    rate: Fraction  #: frames a second, exact, as stated; often the mean if it varies
    tick_s: Fraction  #: seconds of which every frame's time is a multiple
    #: how many frames there are, as counted once all are read; None if the source does not state it
    frames_stated: int | None
    warnings: tuple[str, ...] = ()  #: one-line texts about the source
    problem: str | None = None  #: why frames are missing, once the others have been read
    start_s: Fraction | None = None  #: time of the first frame in the file; None without audio
    name_numbers: Sequence[int] = ()  #: those in the images' names, if frames are counted from 0
    numbers_follow_times = False  #: whether missing frames are missing in the numbers

    @property
    def numbers_stated(self) -> tuple[int, int] | None:
        """Number of the first and of the last frame; None if that is not known."""
        return (0, self.frames_stated - 1) if self.frames_stated else None

    @abstractmethod
    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """The frames of a span; to be called once.

        ``index`` is the frame's number, and ``timestamp_s`` counts from the first of all frames and
        always grows.
        """

    def count(self, span: Span) -> int | None:
        """Number of frames in a span; None if that is not known."""
        if self.frames_stated is None:
            return None
        evenly = ((index, index / self.rate, None) for index in range(self.frames_stated))
        return sum(1 for _ in span.select(evenly))

    def close(self) -> None:  # noqa: B027 - there may be none
        """Close the files."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


FALLBACK_RATE = Fraction(25)  #: frames a second if the source states no rate
_NTSC = tuple(Fraction(n * 1000, 1001) for n in (12, 15, 24, 30, 48, 60, 120, 240))
_RATE = re.compile(r"\d{1,9}(\.\d{1,6})?|\d{1,15}/[1-9]\d{0,14}", re.ASCII)
_DECIMALS = (2, 3)
_TOLERANCE = 2e-5
_MAX_DENOMINATOR = 1_000_000
_MAX_FPS = 10_000
_MAX_TICKS = 1_200_000
_COARSE_TICKS = 1000
_MAX_DURATION_TICKS = 1 << 28  # ticks; MP4 keeps the distance of two frames in 32 bits


def exact_rate(fps: float | Fraction) -> Fraction | None:
    """The exact fraction of a rounded frame rate, in frames a second.

    Containers that store decimals or whole nanoseconds write 29.97 or 33366700 ns for 30000/1001;
    such values become the NTSC rate, as do averages within 0.002 % of an NTSC or a whole rate. Any
    other fraction with a denominator up to a million is found exactly. None if the value is not
    valid (zero, negative, not finite, too large).
    """
    fps = float(fps)
    if not math.isfinite(fps) or not 0 < fps <= _MAX_FPS:
        return None
    for rate in (*_NTSC, Fraction(round(fps) or 1)):
        # An NTSC rate may be rounded to two or three decimals, such as 23.98.
        is_rounded = rate.denominator > 1 and fps in {round(float(rate), n) for n in _DECIMALS}
        if abs(fps / float(rate) - 1) < _TOLERANCE or is_rounded:
            return rate
    return Fraction(fps).limit_denominator(_MAX_DENOMINATOR) or Fraction(fps)


def rate_text(rate: Fraction) -> str:
    """``30000/1001``; ``25/1`` for whole rates, so that there is one form to parse."""
    return f"{rate.numerator}/{rate.denominator}"


def parse_rate(text: str) -> Fraction | None:
    """A frame rate: a fraction, or decimals as :func:`exact_rate` takes them; None for others."""
    if _RATE.fullmatch(text) is None:
        return None
    return Fraction(text) or None if "/" in text else exact_rate(Fraction(text))


@dataclass(frozen=True, slots=True)
class Timing:
    """When the frames of a video are shown."""

    rate: Fraction  #: frames a second, as stated; often the mean if it varies
    tick_s: Fraction = Fraction(1, 1000)  #: seconds that all times of the source are multiples of
    source_rate: Fraction | None = None  #: frames a second of the source; None if not known
    step: int | None = 1  #: difference of the frames' numbers in the source; None if irregular

    @property
    def time_base(self) -> Fraction:
        """Seconds a tick of a time base that represents the times of all frames.

        Multiples of the frame interval and all times of the source are exact. Where that takes more
        ticks than a container can represent, multiples of the interval are, if these can be; other
        times are rounded.
        """
        grid, source = self.rate.numerator, self.tick_s.denominator
        most = min(_MAX_TICKS, int(_MAX_DURATION_TICKS * self.rate))
        candidates = (math.lcm(grid, source), most // grid * grid or source, _COARSE_TICKS)
        return Fraction(1, next((ticks for ticks in candidates if ticks <= most), _COARSE_TICKS))


class Timeline:
    """Assigns numbers and times to frames, by their timestamps and the video's rate.

    Attributes:
        start_s: timestamp of the first frame in the file.
        index: number of the last frame.
        time_s: its time from the first frame; -1 before there is one.
        lost: how many frames are missing so far.
        has_gaps: whether the file states that data may be missing somewhere.
    """

    has_gaps = False

    def __init__(
        self,
        rate: Fraction,
        tick_s: Fraction,
        first_ticks: int | None,
        *,
        is_constant: bool,
        failed: int = 0,
        stated_ticks: int | None = None,
    ) -> None:
        """Begin before the first frame.

        ``tick_s`` is seconds a tick of the stream's time base, ``first_ticks`` the timestamp of the
        first frame that can be decoded, ``failed`` how many before it cannot be, and
        ``stated_ticks`` the start that the file states; None for none. With ``is_constant``,
        frames are evenly spaced, so that numbers can follow the times.
        """
        self._rate, self._tick_s, self._is_constant = rate, tick_s, is_constant
        # Two roundings, of a frame's time and of the first one's, and the rate's own.
        self._rounding_s = tick_s * Fraction(11, 10)
        if (1 / rate / tick_s).denominator == 1:  # nothing is rounded
            self._rounding_s = min(self._rounding_s, 1 / rate / 2)
        self._unassigned, first = failed, first_ticks or 0
        begins_early = failed > 0 and stated_ticks is not None
        self.start_s = tick_s * (min(first, stated_ticks or 0) if begins_early else first)
        self.index, self.time_s, self.lost = -1, Fraction(-1), 0

    def add(self, ticks: int | None, failed: int) -> tuple[int, Fraction]:
        """Number and time of the next frame.

        ``ticks`` is its timestamp; None if it has none. ``failed`` frames between it and the one
        before could not be decoded.
        """
        self._unassigned += failed
        measured_s = None if ticks is None else ticks * self._tick_s - self.start_s
        index = self.index + 1
        # After damage, further frames may be missing without a packet that tells it.
        may_miss = self._is_constant and (self.has_gaps or self.lost > 0)
        index += self._missing(index, measured_s) if may_miss or self._unassigned else 0
        self.time_s = self._time(index, measured_s)
        self.index = index
        return index, self.time_s

    def end(self, failed: int) -> None:
        """Count the frames after the last one that could not be decoded."""
        self.lost += self._unassigned + failed
        self._unassigned = 0

    def _missing(self, index: int, measured_s: Fraction | None) -> int:
        """Number of frames missing before the next, by its timestamp if that is regular."""
        missing = self._unassigned
        if measured_s is not None:
            by_time = round(measured_s * self._rate)
            if self._is_regular(by_time, measured_s):
                missing = max(0, by_time - index)
        self._unassigned = max(0, self._unassigned - missing)
        self.lost += missing
        return missing

    def _time(self, index: int, measured_s: Fraction | None) -> Fraction:
        """A multiple of the exact frame interval, or the frame's timestamp if it is irregular."""
        if measured_s is None:
            return index / self._rate if self.time_s < 0 else self.time_s + 1 / self._rate
        time_s = index / self._rate if self._is_regular(index, measured_s) else measured_s
        if time_s > self.time_s:
            return time_s
        # Timestamps repeat or go back a little by rounding, and a lot where streams were joined.
        is_rounding = self.time_s - time_s < 1 / self._rate
        return self.time_s + (self._tick_s if is_rounding else 1 / self._rate)

    def _is_regular(self, index: int, measured_s: Fraction) -> bool:
        return abs(index / self._rate - measured_s) <= self._rounding_s


TimeCode = tuple[int, ...]
"""A SMPTE time code (ST 12-1) as a ``Frame`` has it: hours, minutes, seconds, frame, and flags.

Above 30 frames a second, ST 12-1 and EXR number pairs of frames, whose second one has a flag; the
headers of videos number all frames.
"""
_TIME_CODE = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)", re.ASCII)
_FRAME, _SECOND_OF_PAIR = 3, 6  # places of the numbers
_FURTHER = (0,) * 13  # flags and binary groups, which containers do not state
_DAY_MINUTES = 24 * 60
_MOST_COUNTED_FPS = 60
_MOST_FPS_UNPAIRED = 30
_COUNTED_TOLERANCE = 0.002  # 30000/1001 frames a second are counted as 30


def header_time_code(
    container: InputContainer, stream: VideoStream, rate: Fraction
) -> TimeCode | None:
    """The time code of a video's first frame, by its file and frames a second; None if none."""
    tables = (stream.metadata, container.metadata, *(other.metadata for other in container.streams))
    texts = (text for table in tables for key, text in table.items() if key.lower() == "timecode")
    return next(filter(None, (parse_time_code(text, rate) for text in texts)), None)


def parse_time_code(text: str, rate: Fraction) -> TimeCode | None:
    """The time code that :func:`time_code_text` writes; None for any other text."""
    match = _TIME_CODE.fullmatch(text)
    if match is None:
        return None
    hours, minutes, seconds, frame = (int(match[i]) for i in (1, 2, 3, 5))
    return _with_frame((hours, minutes, seconds, 0, int(match[4] != ":"), *_FURTHER), frame, rate)


def time_code_after(start: TimeCode, frames: int, rate: Fraction) -> TimeCode | None:
    """The time code a number of frames later; None if frames of this rate are not counted so.

    Of a drop-frame time code, two numbers of 30 are left out every minute, except every tenth.
    ``frames`` is not negative, and ``rate`` is frames a second.
    """
    hours, minutes, seconds, _, is_drop = start[:5]
    number, base = _frame_of(start, rate), round(rate)
    dropped = base // 15 if is_drop else 0
    is_counted = 0 < base <= _MOST_COUNTED_FPS and abs(rate / base - 1) < _COUNTED_TOLERANCE
    if not is_counted or (dropped and base % 30):
        return None
    minute = 60 * base - dropped
    ten_minutes = 10 * minute + dropped
    minutes += 60 * hours
    count = (60 * minutes + seconds) * base + number - dropped * (minutes - minutes // 10)
    tens, rest = divmod((count + frames) % (_DAY_MINUTES // 10 * ten_minutes), ten_minutes)
    left_out = dropped * (max(0, rest - dropped) // minute)
    seconds, number = divmod(tens * 600 * base + rest + left_out, base)
    later = seconds // 3600, seconds // 60 % 60, seconds % 60
    return _with_frame((*later, *start[_FRAME:]), number, rate)


def time_code_text(time_code: TimeCode, rate: Fraction) -> str:
    """``01:02:03:04``, of frames of a rate; with ``;`` if it is a drop-frame time code."""
    hours, minutes, seconds, _, is_drop = time_code[:5]
    frame = _frame_of(time_code, rate)
    return f"{hours:02d}:{minutes:02d}:{seconds:02d}{':;'[is_drop]}{frame:02d}"


def time_code_label(first: TimeCode | None, timing: Timing) -> dict[str, str]:
    """Metadata from which FFmpeg writes the time code of a file's first frame; empty for none."""
    if first is None or timing.rate != timing.source_rate:  # which are not consecutive frames
        return {}
    counted = time_code_after(first, 0, timing.rate)
    return {} if counted is None else {"timecode": time_code_text(counted, timing.rate)}


def _frame_of(time_code: TimeCode, rate: Fraction) -> int:
    """The number of the frame within its second."""
    number = time_code[_FRAME]
    is_paired = round(rate) > _MOST_FPS_UNPAIRED
    return 2 * number + time_code[_SECOND_OF_PAIR] if is_paired else number


def _with_frame(time_code: TimeCode, number: int, rate: Fraction) -> TimeCode:
    """A time code with another number of the frame within its second."""
    if round(rate) <= _MOST_FPS_UNPAIRED:
        return *time_code[:_FRAME], number, *time_code[_FRAME + 1 :]
    flags = time_code[_FRAME + 1 : _SECOND_OF_PAIR]
    pair, second = divmod(number, 2)
    return *time_code[:_FRAME], pair, *flags, second, *time_code[_SECOND_OF_PAIR + 1 :]
