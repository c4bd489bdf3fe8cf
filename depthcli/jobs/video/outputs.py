"""The outputs of a planned video, open."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING

from depthcli.io.writers.preview import PreviewWriter
from depthcli.video.codecs import preview_codec
from depthcli.video.depth_output import depth_video
from depthcli.video.formats import VIDEO_FORMATS, VideoFormat
from depthcli.video.frame_source import files_of
from depthcli.video.number_pattern import number_name
from depthcli.video.preview_output import preview_video
from depthcli.video.rates import Timing
from depthcli.video.sequence_output import SequenceOutput
from depthcli.video.sound import Sound

if TYPE_CHECKING:
    from contextlib import AbstractContextManager
    from fractions import Fraction

    from depthcli.io.writers.options import WriterOptions
    from depthcli.jobs.video.plan import VideoPlan
    from depthcli.video.output import VideoOutput
    from depthcli.video.sequence import ImageSequence
    from depthcli.video.source import VideoSource


def open_output(
    which: VideoFormat,
    plan: VideoPlan,
    writing: WriterOptions,
    source: VideoSource | ImageSequence,
    rate: Fraction,
) -> AbstractContextManager[VideoOutput]:
    """The output of one format, with nothing written yet.

    Args:
        which: the format; JSON is written when all others are.
        plan: where outputs go.
        writing: options of the formats.
        source: what is read.
        rate: frames a second of the output.
    """
    path, inputs, timing = plan.path(which), files_of(source), Timing(rate, source.tick_s)
    if which is VideoFormat.MKV:
        return depth_video(path, timing, writing.png_scale, inputs)
    picture = VIDEO_FORMATS[which].picture
    if picture is None:
        raise ValueError(which)
    writer = writing.writer(picture)
    if not isinstance(writer, PreviewWriter):
        name = partial(number_name, plan.names[which])
        return nullcontext(SequenceOutput(which.value, plan.folder, name, writer, inputs))
    codec = plan.codecs.get(which) or preview_codec(path.suffix.lower(), None)
    start_s = source.start_s if plan.has_sound else None
    sound = None if start_s is None else Sound(plan.source, start_s)
    return preview_video(path, timing, writer, inputs, codec=codec, sound=sound)
