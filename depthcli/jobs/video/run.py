"""What ``depthcli video`` does: a video through the model and into its files."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import BinaryIO

from depthcli.core.parallel.cores import share_cores
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.inference.loading import SessionLoader
from depthcli.io.storage.remote import RemotePath
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.video.plan import VideoPlan, plan_video, video_formats
from depthcli.jobs.video.result import VideoDone
from depthcli.jobs.video.settings import VideoSettings
from depthcli.video.codecs import PreviewCodec
from depthcli.video.formats import VideoFormat
from depthcli.video.frame_source import is_sequence


@dataclass(frozen=True, slots=True)
class VideoRequest:
    """A video, and what is to become of it."""

    #: a file, a folder of numbered pictures, a pattern such as ``plate.%04d.exr``, or ``-``
    video: str
    #: a file for one format, or a stem that several share; a folder, which exists, ends in ``/`` or
    #: has no suffix; a pattern for numbered files; ``-``; None for the video's own folder
    output: str | None = None
    #: what to write; empty for what the output's suffix says, else depth and a preview
    formats: tuple[VideoFormat, ...] = ()
    sidecar: bool = False  #: write the JSON as well
    codec: PreviewCodec | None = None  #: of the preview; None for the usual one of its container
    has_sound: bool = True  #: take the video's sound into the preview
    #: which model runs, and how; without a number of threads, with each worker's share of the cores
    model: SessionLoader = field(default_factory=SessionLoader)
    #: how frames become depth, and which do
    settings: VideoSettings = field(default_factory=VideoSettings)
    #: threads beside the one that decodes and writes; None for one a core
    workers: int | None = None
    stdin: BinaryIO | None = None  #: where ``-`` is read
    stdout: BinaryIO | None = None  #: where ``-`` is written


def video(request: VideoRequest, progress: Progress = NO_PROGRESS) -> VideoDone:
    """Depth of a video, in memory that does not grow with it.

    After an error nothing is left of video files; numbered files that are done stay, and count
    when the same request comes again.

    Args:
        request: the video and its outputs.
        progress: told of each frame, and of how many there will be if the file says so.

    Returns:
        What was written. Its ``problem`` is set if the video ended early; what there was is
        written.

    Raises:
        InputError: the video cannot be read, or has no frame in the span.
        OutputError: an output cannot be written.
        ModelError: the model cannot be used.
        UsageError: the outputs do not fit the video, or each other, or the options the model.
    """
    plan = plan_video(
        request.video,
        request.output,
        video_formats(request.output, request.formats),
        sidecar=request.sidecar,
        codec=request.codec,
        has_sound=request.has_sound,
        stdin=request.stdin,
        stdout=request.stdout,
    )
    workers, threads = share_cores(request.workers, request.model.threads)
    loading = replace(request.model, threads=threads).start()
    # What reads and writes videos is imported while the model loads.
    from depthcli.inference.pipeline import Pipeline  # noqa: PLC0415
    from depthcli.jobs.video.write import write_video  # noqa: PLC0415

    pipeline = Pipeline(loading.result(), request.settings.detail)
    with _at_hand(plan, progress) as here:
        return write_video(here, pipeline, request.settings, workers, progress)


@contextmanager
def _at_hand(plan: VideoPlan, progress: Progress) -> Iterator[VideoPlan]:
    """The plan with a video that FFmpeg's libraries can open: a file, not an object in a store."""
    if not isinstance(plan.source, RemotePath) or is_sequence(plan.source):
        yield plan
        return
    with local_copy(plan.source, progress) as copy:
        yield replace(plan, source=copy)
