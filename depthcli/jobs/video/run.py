"""Predicting the depth of a video, as ``depthcli video`` does."""

from __future__ import annotations

import hashlib
from contextlib import ExitStack
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
    from depthcli.jobs.video.stages import open_source, write_video  # noqa: PLC0415

    pipeline = Pipeline(loading.result(), request.settings.detail)
    with ExitStack() as stack:
        # FFmpeg's libraries open local files.
        if isinstance(plan.source, RemotePath) and not is_sequence(plan.source):
            copy = stack.enter_context(local_copy(plan.source, progress))
            with copy.open("rb") as file:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            plan = replace(plan, source=copy, sha256=sha256)
        source = stack.enter_context(open_source(plan))
        return write_video(plan, source, pipeline, workers, progress)
