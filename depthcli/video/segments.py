"""A video in numbered files of a limited length, each of which is complete when it ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Self

from depthcli.video.outputs import DepthFrame, VideoOutput


class SegmentedOutput(VideoOutput):
    """Outputs that follow each other, cut at multiples of a length."""

    def __init__(
        self, opened: Callable[[int], VideoOutput], length_s: float, number: int = 0
    ) -> None:
        """Prepare the output.

        ``opened`` makes the output of a segment by its number, from ``number`` on, to be entered;
        ``length_s`` is seconds from the first frame on.
        """
        super().__init__()
        self._opened, self._length_s, self._number = opened, length_s, number
        self._output = opened(number)
        self.has_overscan = self._output.has_overscan
        self._first_s: float | None = None
        self._passed, self._warned, self._warning = 0, 0, ""

    def __enter__(self) -> Self:
        self._output.__enter__()
        self.push(self._exit_last)
        return self

    def _exit_last(self, *error: Any) -> None:  # noqa: ANN401 - as of any exit
        self._output.__exit__(*error)

    def encode(self, frame: DepthFrame) -> tuple[float, Any]:
        """Encode a frame, for whichever segment it falls into; also returns its time in seconds."""
        return frame.time_s, self._output.encode(frame)

    def append(self, encoded: tuple[float, Any]) -> None:
        """Write a frame; complete the segment before if it is the first one of another."""
        time_s, part = encoded
        self._first_s = time_s if self._first_s is None else self._first_s
        passed = int((time_s - self._first_s) // self._length_s)
        if passed > self._passed:
            self._complete()
            self._passed, self._number = passed, self._number + 1
            self._output = self._opened(self._number)
            self._output.__enter__()
        self._output.append(part)

    def _complete(self) -> None:
        self._keep(self._output.finish())
        self._output.__exit__(None, None, None)

    def _keep(self, warnings: Sequence[str]) -> None:
        for warning in warnings:
            self._warning = self._warning or warning
            self._warned += 1

    def finish(self) -> tuple[str, ...]:
        """Complete the last segment, and return the first warning of all, with their number."""
        self._keep(self._output.finish())
        if self._warned <= 1:
            return (self._warning,) if self._warned else ()
        return (f"{self._warned} segments, the first: {self._warning}",)
