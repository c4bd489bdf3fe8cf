"""Rate, time base, length and time code of a video stream, before any frame is decoded."""

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import av
from av.container import InputContainer
from av.video.stream import VideoStream

from depthcli.video.rates import FALLBACK_RATE, exact_rate
from depthcli.video.time_code import TimeCode, header_time_code

# Streams without a container, whose average rate FFmpeg sets to 25 whatever they state.
_RAW_FORMATS = {"cavsvideo", "dirac", "dv", "h261", "h263", "h264", "hevc", "m4v", "mjpeg",
                "mpegvideo", "obu", "vc1", "vvc"}  # fmt: skip

# Containers without presentation times: FFmpeg numbers the packets, also those of B-frames.
_NUMBERED_FORMATS = {"avi", "mxf"}


_AVI_UNKNOWN_FRAMES = 1 << 30  # as FFmpeg states in an AVI that it writes into a pipe


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """Rate, time base, length and time code."""

    rate: Fraction  #: frames a second, exact, as the file states it, often as a mean
    is_rate_stated: bool  #: whether the file states it
    is_constant: bool  #: whether frames are evenly spaced, as far as the header tells
    time_base: Fraction  #: seconds a tick, of which every frame's time is a multiple
    #: which of FFmpeg's timestamps the file gives in the order of presentation
    timestamps: Literal["pts", "dts"] | None
    frames: int | None  #: how many there are; None if nothing states it
    time_code: TimeCode | None  #: of the first frame; None if nothing states it


def _file_rate(container: InputContainer, stream: VideoStream) -> Fraction | None:
    """Frames a second that the file states; None if it states none."""
    if container.format.name not in _RAW_FORMATS:
        return exact_rate(stream.average_rate or stream.guessed_rate or 0)
    return exact_rate(stream.guessed_rate or 0) if stream.codec_context.framerate else None


def stream_info(container: InputContainer, stream: VideoStream) -> StreamInfo:
    """Read the properties of a stream."""
    stated = _file_rate(container, stream)
    rate = stated or FALLBACK_RATE
    time_base = stream.time_base or 1 / rate
    is_raw = container.format.name in _RAW_FORMATS
    is_constant = is_raw or stream.average_rate == stream.base_rate
    length_s = Fraction(0)
    if stream.duration:
        length_s = stream.duration * time_base
    elif container.duration:
        length_s = Fraction(container.duration, av.time_base)
    is_numbered = container.format.name in _NUMBERED_FORMATS
    is_unknown = container.format.name == "avi" and stream.frames == _AVI_UNKNOWN_FRAMES
    return StreamInfo(
        rate=rate,
        is_rate_stated=stated is not None,
        is_constant=is_constant,
        time_base=time_base,
        frames=None if is_unknown else stream.frames or round(length_s * rate) or None,
        timestamps=None if is_raw else "dts" if is_numbered else "pts",
        time_code=header_time_code(container, stream, rate),
    )
