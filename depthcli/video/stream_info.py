"""Rate, time base, length and time code of a video stream, before any frame is decoded."""

from dataclasses import dataclass
from fractions import Fraction

import av
from av.container import InputContainer
from av.video.stream import VideoStream

from depthcli.video.rates import FALLBACK_RATE, exact_rate
from depthcli.video.time_code import TimeCode, header_time_code
from depthcli.video.truncation import AVI_UNKNOWN_FRAMES


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """Rate, time base, length and time code."""

    rate: Fraction  #: frames a second, exact; the mean where frames are not evenly spaced
    is_rate_stated: bool  #: whether the file states it
    is_constant: bool  #: whether frames are evenly spaced, as far as the header tells
    time_base: Fraction  #: seconds a tick of the stream's times
    tick_s: Fraction  #: seconds of which every frame's time is a multiple
    frames: int | None  #: how many there are; None if nothing states it
    time_code: TimeCode | None  #: of the first frame; None if nothing states it


def stream_info(container: InputContainer, stream: VideoStream) -> StreamInfo:
    """Read the properties of a stream."""
    stated = exact_rate(stream.average_rate or stream.guessed_rate or 0)
    rate = stated or FALLBACK_RATE
    time_base = stream.time_base or 1 / rate
    is_constant = stream.average_rate == stream.base_rate
    length_s = Fraction(0)
    if stream.duration:
        length_s = stream.duration * time_base
    elif container.duration:
        length_s = Fraction(container.duration, av.time_base)
    is_unknown = container.format.name == "avi" and stream.frames == AVI_UNKNOWN_FRAMES
    return StreamInfo(
        rate=rate,
        is_rate_stated=stated is not None,
        is_constant=is_constant,
        time_base=time_base,
        tick_s=Fraction(1, rate.numerator) if is_constant else time_base,
        frames=None if is_unknown else stream.frames or round(length_s * rate) or None,
        time_code=header_time_code(container, stream, rate),
    )
