"""The frames of a depth video with their numbers, times, time codes and geometry."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from depthcli.core.types import Frame
from depthcli.io.depth.stored import StoredDepth, step_scale
from depthcli.video.container import open_video
from depthcli.video.depth import DepthVideo
from depthcli.video.frame_labels import FrameLabels
from depthcli.video.time_code import header_time_code


def depth_frames(
    video: DepthVideo, *, name: str | None = None, scale: float | None = None
) -> Iterator[StoredDepth]:
    """The maps of a depth video; the ``Frame`` of each has its number, time, rate and time code.

    Numbers are those of ``depthcli video``, if it wrote the file; else they count from 0.

    Args:
        video: read from its beginning.
        name: of the file, in messages; None for its path.
        scale: units per metre that the user states; None for what the file states.

    Raises:
        InputError: a frame is damaged or missing; those before it have been yielded.
    """
    labels, stated = _labels(video), step_scale(video.labels, scale)
    first_s, number = None, labels.first - 1
    for count, (stated_number, depth) in enumerate(video.numbered_maps()):
        time_s = (depth.provenance and depth.provenance.time_s) or 0.0
        first_s = time_s if first_s is None else first_s
        found = labels.number(count, time_s - first_s) if stated_number is None else stated_number
        # No two frames have one number, even if their times are too coarse for it.
        number = max(found, number + 1)
        frame = Frame(
            np.zeros((1, 1), np.uint8),
            index=number,
            timestamp_s=time_s,
            rate=video.rate,
            pixel_aspect=labels.pixel_aspect,
            windows=labels.windows(depth.width, depth.height),
            time_code=labels.time_code_at(time_s - first_s),
        )
        yield StoredDepth(name or str(video.path), depth, video.labels, stated, frame)


def _labels(video: DepthVideo) -> FrameLabels:
    """Those of the file; of another program's, its rate and the time code of its header."""
    labels = FrameLabels.parse(video.labels)
    if labels.source_rate is not None or video.rate is None:
        return labels
    container, stream = open_video(video.path)
    with container:
        time_code = header_time_code(container, stream, video.rate)
    return replace(labels, source_rate=video.rate, time_code=time_code)
