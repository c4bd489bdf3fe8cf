"""Creating a video file and its video stream."""

import os
from collections.abc import Mapping
from fractions import Fraction
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
_KEYFRAME_INTERVAL_S = 2
_MAX_GOP = 250
_MAX_ASPECT = 1000
_FRAGMENTS = "+frag_keyframe+empty_moov+default_base_moof"


def new_container(
    target: Path | OutputPipe, timing: Timing, labels: Mapping[str, str]
) -> OutputContainer:
    """A new file without streams; its container follows from the suffix, and is reproducible.

    Labels, name -> text, are written to the header as metadata.

    Raises:
        OSError: it cannot be created.
    """
    options = {"fflags": "+bitexact"}
    name, is_pipe = container_format(target.suffix.lower()), isinstance(target, OutputPipe)
    if name in {"mp4", "mov"}:
        # In a pipe, fragments: an index at the beginning could only be written after all frames.
        layout = _FRAGMENTS if is_pipe else "+faststart"
        ticks = str(timing.time_base.denominator)
        options |= {"movflags": layout, "video_track_timescale": ticks}
    if not isinstance(target, OutputPipe):
        target.touch()  # problems with the folder are reported before the work begins
    file = target if is_pipe else str(target)
    container = av.open(file, "w", format=name, container_options=options)
    container.metadata.update(labels)
    return container


def delay_header(container: OutputContainer) -> None:
    """Write the header of an MP4 in a pipe with its first fragment, which waits for the audio.

    Else it could not state where the audio begins. No effect after the encoding has started.
    """
    options = container.container_options
    if _FRAGMENTS in options.get("movflags", ""):
        options["movflags"] += "+delay_moov"


def state_pixel_aspect(stream: VideoStream, pixel_aspect: float) -> None:
    """State the width by height of pixels that are not square: in MP4, MOV and FFV1.

    PyAV cannot set it for Matroska and WebM themselves.
    """
    aspect = Fraction(pixel_aspect).limit_denominator(_MAX_ASPECT)
    stream.codec_context.sample_aspect_ratio = aspect


def add_video(
    container: OutputContainer, codec: Codec, timing: Timing, width: int, height: int
) -> VideoStream:
    """Add a video stream for frames of a size."""
    if codec is Codec.AV1:
        os.environ.setdefault("SVT_LOG", "0")  # else it writes to standard error
    encoding = ENCODINGS[codec]
    options = encoding.options_for(width, height)
    stream = cast(
        "VideoStream", container.add_stream(encoding.encoder, rate=timing.rate, options=options)
    )
    stream.width, stream.height = width, height
    stream.pix_fmt = encoding.pixel_format
    stream.time_base = timing.time_base
    context = stream.codec_context
    context.time_base = timing.time_base
    keyframe_interval = max(1, min(round(_KEYFRAME_INTERVAL_S * timing.rate), _MAX_GOP))
    context.gop_size = 1 if encoding.is_intra_only else keyframe_interval
    if encoding.pixel_format != DEPTH_PIXELS:
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = ColorRange.MPEG
    return stream
