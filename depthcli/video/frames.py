"""The base class of sources of frames."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Self

from depthcli.core.types import Frame
from depthcli.video.spans import WHOLE, Span


class FrameSource(ABC):
    """Frames in their order, one at a time in memory."""

    paths: tuple[Path, ...]  #: the files that are read; none of a pipe
    rate: Fraction  #: frames a second, exact, as stated; often the mean if it varies
    tick_s: Fraction  #: seconds of which every frame's time is a multiple
    frames_stated: int | None  #: how many frames there are; None if the source does not state it
    warnings: tuple[str, ...] = ()  #: one-line texts about the source
    #: why frames are missing, once the others have been read; None if all were read
    problem: str | None = None
    #: time of the first frame in the file, which its audio refers to; None without audio
    start_s: Fraction | None = None
    #: whether frames that are missing in the source are missing in the numbers
    numbers_follow_times = False

    @property
    def numbers_stated(self) -> tuple[int, int] | None:
        """Number of the first and of the last frame; None if that is not known."""
        return (0, self.frames_stated - 1) if self.frames_stated else None

    @abstractmethod
    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """The frames of a span; to be called once.

        Yields:
            ``index`` is the frame's number, and ``timestamp_s`` counts from the first of all frames
            and always grows.
        """

    def count(self, span: Span) -> int | None:
        """How many frames a span has; None if that is not known."""
        return None if self.frames_stated is None else span.count(self.frames_stated, self.rate)

    def close(self) -> None:  # noqa: B027 - there may be none
        """Close the files."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
