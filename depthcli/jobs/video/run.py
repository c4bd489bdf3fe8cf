"""What ``depthcli video`` does: a video through the model and into its files."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from depthcli.core.parallel.cores import share_cores
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.io.storage.remote import RemotePath
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.video.plan import VideoPlan, plan_video
from depthcli.jobs.video.request import VideoRequest
from depthcli.jobs.video.result import VideoDone
from depthcli.video.frame_source import is_sequence


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
    plan = plan_video(request)
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
