"""A new video file with a stream for frames of one codec."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, cast

import av
from av.video.reformatter import ColorRange

from depthcli.video.codecs import DEPTH_PIXELS, ENCODINGS, Codec, container_format

if TYPE_CHECKING:
    from collections.abc import Mapping
    from fractions import Fraction
    from pathlib import Path

    from av.container import OutputContainer
    from av.video.stream import VideoStream

    from depthcli.video.rates import Timing

_BT709 = 1
_KEY_EVERY_S = 2
_MOST_BETWEEN_KEYS = 250


def new_container(path: Path, timing: Timing, labels: Mapping[str, str]) -> OutputContainer:
    """A file without streams; the same frames will give the same bytes.

    Args:
        path: its suffix says the container.
        timing: of the frames.
        labels: name -> text, kept in the header.

    Raises:
        OSError: it cannot be made.
    """
    options = {"fflags": "+bitexact"}
    if path.suffix.lower() in {".mp4", ".mov"}:
        ticks = str(timing.clock.denominator)
        options |= {"movflags": "+faststart", "video_track_timescale": ticks}
    path.touch()  # what is wrong with the folder is said before the work begins
    name = container_format(path.suffix.lower())
    container = av.open(str(path), "w", format=name, container_options=options)
    container.metadata.update(labels)
    return container


def add_video(
    container: OutputContainer, codec: Codec, timing: Timing, width: int, height: int
) -> VideoStream:
    """A stream for frames of a size, compressed by a codec."""
    if codec is Codec.AV1:
        os.environ.setdefault("SVT_LOG", "0")  # else it writes to standard error
    encoding = ENCODINGS[codec]
    options = encoding.options_for(width, height)
    stream = cast(
        "VideoStream", container.add_stream(encoding.encoder, rate=timing.rate, options=options)
    )
    stream.width, stream.height = width, height
    stream.pix_fmt = encoding.pixel_format
    stream.time_base = timing.clock
    context = stream.codec_context
    context.time_base = timing.clock
    context.gop_size = 1 if encoding.is_all_key else _frames_between_keys(timing.rate)
    if encoding.pixel_format != DEPTH_PIXELS:
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = ColorRange.MPEG
    return stream


def _frames_between_keys(rate: Fraction) -> int:
    return max(1, min(round(_KEY_EVERY_S * rate), _MOST_BETWEEN_KEYS))
