"""What frames come from: a video file, a pipe, or numbered pictures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Self

from depthcli.core.choices import MAX_PIXELS
from depthcli.video.number_pattern import is_pattern
from depthcli.video.spans import WHOLE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    from depthcli.core.picture_limit import PictureLimit
    from depthcli.core.types import Frame
    from depthcli.video.pipes import InputPipe
    from depthcli.video.spans import Span


class FrameSource(ABC):
    """Frames in their order, with one of them in memory.

    Attributes:
        paths: the files that are read; none of a pipe.
        rate: frames a second, exact; the mean where frames are not evenly spaced.
        tick_s: seconds of which every frame's time is a multiple.
        frames_stated: how many frames there are; None if nothing says so.
        width: columns of an upright frame.
        height: rows of an upright frame.
        warnings: one-line texts about the source.
        problem: why frames are missing, once the others have been read; None if all came.
        start_s: time of the first frame on the clock of the sound beside it; None without one.
    """

    paths: tuple[Path, ...]
    rate: Fraction
    tick_s: Fraction
    frames_stated: int | None
    width: int
    height: int
    warnings: tuple[str, ...] = ()
    problem: str | None = None
    start_s: Fraction | None = None

    @abstractmethod
    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """The frames of a span; to be called once.

        Yields:
            ``index`` is the frame's number, and ``timestamp_s`` counts from the first of all frames
            and always grows.
        """

    def count(self, span: Span) -> int | None:
        """How many frames a span has; None if nothing says so."""
        return None if self.frames_stated is None else span.count(self.frames_stated, self.rate)

    def close(self) -> None:  # noqa: B027 - there may be none
        """Let the files go."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def is_sequence(path: str | Path) -> bool:
    """Whether a name stands for numbered pictures: a folder, or a pattern that is no file."""
    path = Path(path)
    return path.is_dir() or (is_pattern(path.name) and not path.exists())


def open_frames(
    source: Path | InputPipe,
    *,
    rate: Fraction | None = None,
    max_pixels: int | PictureLimit = MAX_PIXELS,
) -> FrameSource:
    """Open a video or a sequence.

    Args:
        source: a file, a folder, a pattern such as ``plate.%04d.exr``, or a pipe.
        rate: frames a second of a sequence; None for what it states.
        max_pixels: frames that claim more are refused.

    Raises:
        InputError: it cannot be read.
    """
    # Each loads what it needs and nothing else.
    if isinstance(source, Path) and is_sequence(source):
        from depthcli.video.sequence import ImageSequence  # noqa: PLC0415

        return ImageSequence(source, rate=rate, max_pixels=max_pixels)
    from depthcli.video.source import VideoSource  # noqa: PLC0415

    return VideoSource(source, max_pixels=max_pixels)
