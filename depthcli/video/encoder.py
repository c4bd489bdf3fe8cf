"""A new video file with a stream for frames of one codec."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import av
from av.container import OutputContainer
from av.video.reformatter import ColorRange
from av.video.stream import VideoStream

from depthcli.video.codecs import DEPTH_PIXELS, ENCODINGS, Codec, container_format
from depthcli.video.pipes import OutputPipe
from depthcli.video.rates import Timing

_BT709 = 1
_KEY_EVERY_S = 2
_MOST_BETWEEN_KEYS = 250


def new_container(
    target: Path | OutputPipe, timing: Timing, labels: Mapping[str, str]
) -> OutputContainer:
    """A file without streams, by its suffix; the same frames will give the same bytes.

    Labels, name -> text, are kept in the header.

    Raises:
        OSError: it cannot be made.
    """
    options = {"fflags": "+bitexact"}
    name, is_pipe = container_format(target.suffix.lower()), isinstance(target, OutputPipe)
    if name in {"mp4", "mov"}:
        # A header with the places of all frames would have to wait for the last one.
        layout = "+frag_keyframe+empty_moov+default_base_moof" if is_pipe else "+faststart"
        ticks = str(timing.clock.denominator)
        options |= {"movflags": layout, "video_track_timescale": ticks}
    if not isinstance(target, OutputPipe):
        target.touch()  # what is wrong with the folder is said before the work begins
    file = target if is_pipe else str(target)
    container = av.open(file, "w", format=name, container_options=options)
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
    between_keys = max(1, min(round(_KEY_EVERY_S * timing.rate), _MOST_BETWEEN_KEYS))
    context.gop_size = 1 if encoding.is_all_key else between_keys
    if encoding.pixel_format != DEPTH_PIXELS:
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = ColorRange.MPEG
    return stream
