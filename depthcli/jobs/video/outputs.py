"""The outputs of a planned video, open."""

from contextlib import AbstractContextManager, nullcontext
from fractions import Fraction
from functools import partial
from pathlib import Path

from depthcli.io.writers.options import WriterOptions
from depthcli.io.writers.preview import PreviewWriter
from depthcli.jobs.video.plan import VideoPlan
from depthcli.video.codecs import preview_codec
from depthcli.video.depth_output import depth_video
from depthcli.video.formats import VIDEO_FORMATS, VideoFormat
from depthcli.video.frames import FrameSource
from depthcli.video.number_pattern import number_name
from depthcli.video.output import VideoOutput
from depthcli.video.preview_output import preview_video
from depthcli.video.rates import Timing
from depthcli.video.sequence_output import SequenceOutput
from depthcli.video.sound import Sound


def open_output(
    which: VideoFormat,
    plan: VideoPlan,
    writing: WriterOptions,
    source: FrameSource,
    rate: Fraction,
    written: Path | None = None,
) -> AbstractContextManager[VideoOutput]:
    """The output of one format, with nothing written yet.

    Args:
        which: the format; JSON is written when all others are.
        plan: where outputs go.
        writing: options of the formats.
        source: what is read.
        rate: frames a second of the output.
        written: where a depth video is written until it is whole; None for a temporary name.
    """
    target, inputs, timing = plan.target(which), source.paths, Timing(rate, source.tick_s)
    if which is VideoFormat.MKV:
        return depth_video(target, timing, writing.png_scale, inputs, written)
    picture = VIDEO_FORMATS[which].picture
    if picture is None:
        raise ValueError(which)
    writer = writing.writer(picture)
    if not isinstance(writer, PreviewWriter):
        name = partial(number_name, plan.names[which])
        return nullcontext(SequenceOutput(which.value, plan.folder, name, writer, inputs))
    codec = plan.codecs.get(which) or preview_codec(target.suffix.lower(), None)
    sound = None
    if plan.has_sound and source.start_s is not None:
        sound = Sound(plan.source, source.start_s)
    return preview_video(target, timing, writer, inputs, codec=codec, sound=sound)
