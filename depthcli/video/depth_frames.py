"""The frames of a depth video with their numbers, times and time codes."""

from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from depthcli.core.types import Frame
from depthcli.io.depth.metadata import number
from depthcli.io.depth.stored import StoredDepth, step_scale
from depthcli.video.container import open_video
from depthcli.video.depth import DepthVideo
from depthcli.video.time_code import TimeCode, header_time_code, time_code_after

_TOLERANCE_S = Fraction(6, 10_000)  # Matroska rounds times to milliseconds
_MAX_TOLERANCE = Fraction(3, 10)  # of the time between two frames


def depth_frames(
    video: DepthVideo, *, name: str | None = None, scale: float | None = None
) -> Iterator[StoredDepth]:
    """The maps of a depth video; the ``Frame`` of each has its number, time, rate and time code.

    Numbers begin with that of the first frame. If the frame rate is constant, a frame that is
    missing in the source is missing in the numbers, too; else they are consecutive.

    Args:
        video: read from its beginning.
        name: of the file, in messages; None for its path.
        scale: steps per metre that the user states; None for what the file states.

    Raises:
        InputError: a frame is damaged or missing; those before it have been yielded.
    """
    rate, first = video.rate, int(number(video.labels.get("first_frame")) or 0)
    start, is_regular = _timing(video.path, rate)
    first_s: float | None = None
    for count, depth in enumerate(video):
        time_s = (depth.provenance and depth.provenance.time_s) or 0.0
        first_s = time_s if first_s is None else first_s
        offset = round((time_s - first_s) * rate) if rate and is_regular else count
        frame = Frame(
            np.zeros((1, 1), np.uint8),
            index=first + offset,
            timestamp_s=time_s,
            rate=rate,
            time_code=time_code_after(start, offset, rate) if start and rate else None,
        )
        stated = step_scale(video.labels, scale)
        yield StoredDepth(name or str(video.path), depth, video.labels, stated, frame)


def _timing(path: Path, rate: Fraction | None) -> tuple[TimeCode | None, bool]:
    """Time code of the first frame, and whether all times are multiples of a frame's duration."""
    container, stream = open_video(path)
    ticks: list[int] = []
    with container, suppress(av.FFmpegError):  # decoding reports what is damaged
        start = header_time_code(container, stream)
        ticks.extend(packet.pts for packet in container.demux(stream) if packet.pts is not None)
    if rate is None or stream.time_base is None:
        return start, False
    tolerance = min(_TOLERANCE_S * rate, _MAX_TOLERANCE)
    places = [(tick - ticks[0]) * stream.time_base * rate for tick in ticks]
    return start, all(abs(place - round(place)) <= tolerance for place in places)
