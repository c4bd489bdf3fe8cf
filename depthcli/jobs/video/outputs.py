"""Opening the outputs of a planned video."""

from contextlib import AbstractContextManager, nullcontext
from fractions import Fraction
from functools import partial

from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.table import WriterOptions
from depthcli.io.storage.guard import Guard
from depthcli.jobs.video.plan import VideoPlan
from depthcli.video.audio import AudioTrack
from depthcli.video.codecs import preview_codec
from depthcli.video.depth_output import depth_video
from depthcli.video.formats import VIDEO_FORMATS, VideoFormat
from depthcli.video.frames import FrameSource
from depthcli.video.number_pattern import numbered_name
from depthcli.video.output import VideoOutput
from depthcli.video.preview_output import preview_video
from depthcli.video.rates import Timing
from depthcli.video.sequence_output import SequenceOutput


def open_output(
    which: VideoFormat,
    plan: VideoPlan,
    writing: WriterOptions,
    source: FrameSource,
    rate: Fraction,
    guard: Guard,
) -> AbstractContextManager[VideoOutput]:
    """Open the output of one format.

    Args:
        which: the format; not JSON, which is written after all others.
        plan: the paths of the outputs.
        writing: options of the formats.
        source: the video or sequence that is read.
        rate: frames per second of the output.
        guard: of existing files.
    """
    target = plan.target(which)
    step = source.rate / rate
    is_stepped = not source.numbers_follow_times and step.denominator == 1
    timing = Timing(rate, source.tick_s, source.rate, step.numerator if is_stepped else None)
    if which is VideoFormat.MKV:
        colours = PreviewWriter(vmin=writing.vmin, vmax=writing.vmax)
        return depth_video(target, timing, writing.png_scale, guard, colours)
    picture = VIDEO_FORMATS[which].picture
    if picture is None:
        raise ValueError(which)
    writer = writing.writer(picture)
    if not isinstance(writer, PreviewWriter):
        name = partial(numbered_name, plan.names[which])
        is_exr = which is VideoFormat.EXR
        return nullcontext(
            SequenceOutput(which.value, plan.folder, name, writer, guard, has_overscan=is_exr)
        )
    codec = plan.codecs.get(which) or preview_codec(target.suffix.lower(), None)
    audio = None
    if plan.has_audio and source.start_s is not None:
        audio = AudioTrack(plan.source, source.start_s)
    return preview_video(target, timing, writer, guard, codec=codec, audio=audio)
