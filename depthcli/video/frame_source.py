"""Opening a source of frames: a video file, a pipe, or numbered pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.choices import MAX_PIXELS
from depthcli.core.picture_options import AS_STATED, ReadOptions
from depthcli.errors import InputError
from depthcli.io.storage.remote import path_of
from depthcli.video.number_pattern import is_pattern

if TYPE_CHECKING:
    from fractions import Fraction

    from depthcli.video.frames import FrameSource
    from depthcli.video.pipes import InputPipe


def is_sequence(path: str | Path) -> bool:
    """Whether a name stands for numbered pictures: a folder, or a pattern that is no file.

    Raises:
        InputError: it is in a store that does not answer.
    """
    path = path_of(path)
    try:
        return path.is_dir() or (is_pattern(path.name) and not path.exists())
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error


def open_frames(
    source: Path | InputPipe,
    *,
    rate: Fraction | None = None,
    max_pixels: int = MAX_PIXELS,
    options: ReadOptions = AS_STATED,
) -> FrameSource:
    """Open a video or a sequence.

    Args:
        source: a file, a folder, a pattern such as ``plate.%04d.exr``, or a pipe.
        rate: frames a second of a sequence; None for what it states.
        max_pixels: frames that claim more are refused.
        options: for the pictures of a sequence.

    Raises:
        InputError: it cannot be read, or is depth that depthcli wrote.
        UsageError: a folder holds more than one sequence.
    """
    # Each imports only what it needs.
    if isinstance(source, Path) and is_sequence(source):
        from depthcli.video.sequence import ImageSequence  # noqa: PLC0415

        return ImageSequence(source, rate=rate, max_pixels=max_pixels, options=options)
    from depthcli.video.source import VideoSource  # noqa: PLC0415

    video = VideoSource(source, max_pixels=max_pixels)
    if video.is_own_depth:
        video.close()
        raise InputError(
            f"{source} is depth that depthcli wrote; name the video that it was made of "
            "('depthcli info', 'probe' and 'convert' read depth)"
        )
    return video
