"""The numbers and times of a video's frames, also after frames that cannot be decoded."""

from fractions import Fraction


class Timeline:
    """Assigns numbers and times to frames, by their timestamps and the video's rate.

    Attributes:
        start_s: timestamp of the first frame in the file.
        index: number of the last frame.
        time_s: its time from the first frame; -1 before there is one.
        lost: how many frames are missing so far.
    """

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

        Args:
            rate: frames a second.
            tick_s: seconds a tick of the stream's time base.
            first_ticks: timestamp of the first frame that can be decoded; None if it has none.
            is_constant: whether frames are evenly spaced, so that numbers can follow the times.
            failed: how many frames before it cannot be decoded.
            stated_ticks: start time that the file states; None if it states none.
        """
        self._rate = rate
        self._tick_s = tick_s
        # Two roundings, of a frame's time and of the first one's, and the rate's own.
        self._rounding_s = tick_s * Fraction(11, 10)
        if (1 / rate / tick_s).denominator == 1:  # nothing is rounded
            self._rounding_s = min(self._rounding_s, 1 / rate / 2)
        self._is_constant = is_constant
        self._unassigned = failed
        first = first_ticks or 0
        begins_early = failed > 0 and stated_ticks is not None
        self.start_s = tick_s * (min(first, stated_ticks or 0) if begins_early else first)
        self.index = -1
        self.time_s = Fraction(-1)
        self.lost = 0

    def add(self, ticks: int | None, failed: int) -> tuple[int, Fraction]:
        """Number and time of the next frame.

        Args:
            ticks: its timestamp; None if it has none.
            failed: how many frames between it and the one before could not be decoded.
        """
        self._unassigned += failed
        measured_s = None if ticks is None else ticks * self._tick_s - self.start_s
        index = self.index + 1
        # After damage, further frames may be missing without a packet that tells it.
        is_damaged = bool(self._unassigned) or (self._is_constant and self.lost > 0)
        index += self._missing(index, measured_s) if is_damaged else 0
        self.time_s = self._time(index, measured_s)
        self.index = index
        return index, self.time_s

    def end(self, failed: int) -> None:
        """Count the frames after the last one that could not be decoded."""
        self.lost += self._unassigned + failed
        self._unassigned = 0

    def _missing(self, index: int, measured_s: Fraction | None) -> int:
        """How many frames are missing before the next, by its timestamp if that is regular."""
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
