"""Selecting frames of a video."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction


@dataclass(frozen=True, slots=True)
class Point:
    """A time in a video, or an interval."""

    value: Fraction  #: seconds from the first frame, or a frame number from 0; not negative
    in_frames: bool = False  #: whether it is a frame number


@dataclass(frozen=True, slots=True)
class Span:
    """A part of a video."""

    start: Point = Point(Fraction(0))  #: its first frame is the first at or after this point
    #: frames at or after this point are left out; None for the end of the video
    end: Point | None = None
    #: interval between frames; in seconds, the first frame at or after each multiple is selected
    every: Point = Point(Fraction(1), in_frames=True)

    def rate(self, rate: Fraction) -> Fraction:
        """Frames a second of the selection from a video of ``rate`` frames a second."""
        if self.every.in_frames:
            return rate / self.every.value
        return min(rate, 1 / self.every.value)

    def count(self, frames: int, rate: Fraction) -> int:
        """How many frames are selected from a video of ``frames`` evenly spaced ones."""
        start, end = (self._frame(point, rate) for point in (self.start, self.end))
        last = frames if end is None else min(frames, -(-end // 1))
        first = -(-(start or Fraction(0)) // 1)
        step = max(Fraction(1), self._frame(self.every, rate) or Fraction(1))
        return max(0, int(-((first - last) // step)))

    def selected(self, frames: Iterable[tuple[int, Fraction]]) -> Iterator[bool]:
        """Whether each frame, a number and a time in seconds, is selected; ends with the span."""
        due: Fraction | None = None
        for index, time_s in frames:
            if self.end is not None and _at(self.end, index, time_s) >= self.end.value:
                return
            now = _at(self.every, index, time_s)
            started = _at(self.start, index, time_s) >= self.start.value
            if not started or (due is not None and now < due):
                yield False
                continue
            first = now if due is None else due
            due = first + ((now - first) // self.every.value + 1) * self.every.value
            yield True

    @staticmethod
    def _frame(point: Point | None, rate: Fraction) -> Fraction | None:
        """A point as a number of frames from the first one."""
        if point is None:
            return None
        return point.value if point.in_frames else point.value * rate


WHOLE = Span()
"""Every frame."""


def _at(point: Point, index: int, time_s: Fraction) -> Fraction:
    return Fraction(index) if point.in_frames else time_s
