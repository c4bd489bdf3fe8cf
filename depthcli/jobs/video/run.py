"""Predicting the depth of a video, as ``depthcli video`` does."""

import hashlib
from dataclasses import replace

from depthcli.core.parallel import NO_PROGRESS, Progress, share_cores
from depthcli.io.storage.paths import RemotePath, local_copy
from depthcli.jobs.video.plan import VideoRequest, VideoResult, plan_video
from depthcli.video.numbering import is_sequence


def video(request: VideoRequest, progress: Progress = NO_PROGRESS) -> VideoResult:
    """Predict the depth of a video, in constant memory; ``progress`` is advanced for each frame.

    After an error, incomplete video files are removed; complete numbered files are kept, and are
    reused if the same request is made again. ``problem`` of the result is set if the video ended
    early; its frames up to there are written.

    Raises:
        InputError: the video cannot be read, or has no frame in the span.
        OutputError: an output cannot be written.
        UsageError: the outputs do not fit the video, or an option does not fit the model.
    """
    plan = plan_video(request)
    workers, threads = share_cores(
        request.workers or (None if request.live is None else 1),  # depth of the newest frame
        request.model.threads,
    )
    loading = replace(request.model, threads=threads).start()
    # Imported here, while the model loads.
    from depthcli.inference.pipeline import Pipeline  # noqa: PLC0415
    from depthcli.jobs.video.stages import write_video  # noqa: PLC0415

    pipeline = Pipeline(loading.result(), request.settings.detail)
    if not isinstance(plan.source, RemotePath) or is_sequence(plan.source):
        return write_video(plan, pipeline, workers, progress)
    with local_copy(plan.source, progress) as copy:  # FFmpeg's libraries open local files
        with copy.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        plan = replace(plan, source=copy, sha256=sha256)
        return write_video(plan, pipeline, workers, progress)
