"""What frames come from: a video file, or numbered pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.choices import MAX_PIXELS
from depthcli.video.number_pattern import is_pattern

if TYPE_CHECKING:
    from fractions import Fraction

    from depthcli.core.picture_limit import PictureLimit
    from depthcli.video.sequence import ImageSequence
    from depthcli.video.source import VideoSource


def is_sequence(path: str | Path) -> bool:
    """Whether a name stands for numbered pictures: a folder, or a pattern that is no file."""
    path = Path(path)
    return path.is_dir() or (is_pattern(path.name) and not path.exists())


def open_frames(
    path: Path, *, rate: Fraction | None = None, max_pixels: int | PictureLimit = MAX_PIXELS
) -> VideoSource | ImageSequence:
    """Open a video or a sequence.

    Args:
        path: a file, a folder, or a pattern such as ``plate.%04d.exr``.
        rate: frames a second of a sequence; None for what it states.
        max_pixels: frames that claim more are refused.

    Raises:
        InputError: it cannot be read.
    """
    # Each loads what it needs and nothing else.
    if is_sequence(path):
        from depthcli.video.sequence import ImageSequence  # noqa: PLC0415

        return ImageSequence(path, rate=rate, max_pixels=max_pixels)
    from depthcli.video.source import VideoSource  # noqa: PLC0415

    return VideoSource(path, max_pixels=max_pixels)


def files_of(source: VideoSource | ImageSequence) -> list[Path]:
    """The files that a source reads."""
    return [file.path for file in getattr(source, "files", ())] or [source.path]
