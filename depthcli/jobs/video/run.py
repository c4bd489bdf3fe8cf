"""What ``depthcli video`` does: frames through the model, over time, and into their files."""

from __future__ import annotations

import dataclasses
import time
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Any

from depthcli.cli.video_resume import progress_of
from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.core.progress import NO_PROGRESS
from depthcli.errors import InputError, OutputError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.video.formats import VideoFormat
from depthcli.io.video.frame_source import open_frames
from depthcli.io.video.sequence import ImageSequence
from depthcli.jobs.video.result import VideoDone
from depthcli.jobs.video.stages import Reel, VideoSettings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from depthcli.core.progress import Progress
    from depthcli.core.types import Frame
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.video.output import VideoFrame, VideoOutput
    from depthcli.io.video.source import VideoSource
    from depthcli.io.writers.options import WriterOptions
    from depthcli.jobs.video.plan import VideoJob

_ON_GRID = 1e-6


def run_video(
    job: VideoJob,
    pipeline: Pipeline,
    settings: VideoSettings,
    progress: Progress = NO_PROGRESS,
) -> VideoDone:
    """Depth of a video, in memory that does not grow with it.

    After an error nothing is left of video files; numbered files that are done stay, and count
    when the same job runs again.

    Args:
        job: the video and its outputs.
        pipeline: the model; its session should have one thread where there are several workers.
        settings: options.
        progress: told of each frame, and of how many there will be if the file says so.

    Returns:
        What was written. Its ``problem`` is set if the video ended early; what there was is
        written.

    Raises:
        InputError: the video cannot be read, or has no frame in the span.
        OutputError: an output cannot be written.
        ModelError: the network failed.
        UsageError: the options do not fit the model.
    """
    start = time.perf_counter()
    for which in job.names:
        if job.path(which).is_dir():
            raise OutputError(
                f"{job.path(which)} is a folder; move it away or choose another --out"
            )
    with (
        open_frames(job.source, rate=settings.fps, max_pixels=settings.limit) as source,
        ExitStack() as stack,
    ):
        rate = settings.span.rate(source.rate)
        earlier = stack.enter_context(progress_of(job, source, pipeline, settings))
        videos = [which for which in job.names if which is not VideoFormat.JSON]
        outputs = [
            stack.enter_context(job.open(which, settings.looks, source, rate)) for which in videos
        ]
        sidecar = (
            stack.enter_context(atomic_path(job.path(VideoFormat.JSON), inputs=(job.source,)))
            if VideoFormat.JSON in job.names
            else None
        )
        reel = Reel(pipeline, settings, earlier.kept)
        advance = progress.begin(job.name, _frame_count(source, settings), "frames")

        def done_one(number: int) -> None:
            earlier.add(number)
            advance(1)

        _through(source, reel, outputs, settings, done_one)
        if reel.first is None:
            raise InputError(_nothing(job, source))
        times_s = [time_s - reel.times_s[0] for time_s in reel.times_s]
        warnings = [*source.warnings, *pipeline.session.warnings]
        for output in outputs:
            warnings += output.finish()
        is_regular = all(abs(t * rate - i) < _ON_GRID for i, t in enumerate(times_s))
        smooths = settings.smooth_s > 0
        done = VideoDone(
            name=job.name,
            outputs=tuple(str(job.path(which)) for which in job.names),
            numbers=reel.numbers,
            rate=rate,
            source_rate=source.rate,
            is_regular=is_regular,
            first=reel.first[0],
            depth=reel.first[1],
            flicker=(reel.smoothed if smooths else reel.raw).value,
            flicker_unsmoothed=reel.raw.value if smooths else None,
            scenes=reel.scenes,
            smooth_s=settings.smooth_s,
            lock_s=settings.lock_s,
            scale=_scale(job, settings.looks),
            provider=pipeline.session.provider,
            seconds=time.perf_counter() - start,
            warnings=tuple(warnings),
            problem=source.problem,
        )
        if sidecar is not None:
            sidecar.write_text(done.sidecar(), "utf-8")
    return done._replace(seconds=time.perf_counter() - start)


def _through(
    source: VideoSource | ImageSequence,
    reel: Reel,
    outputs: Sequence[VideoOutput],
    settings: VideoSettings,
    done_one: Callable[[int], None],
) -> None:
    """Every frame through all stages, each stage a few frames ahead of the next."""

    def encoded(shot: VideoFrame) -> list[Any]:
        whole = reel.depth_of(shot)
        return [output.encode(whole) for output in outputs]

    workers = settings.workers
    # Closed before the outputs are: no thread may write into what is being removed.
    with (
        one_thread_each(workers),
        closing(ordered_map(reel.see, _numbered(source, settings), workers=workers)) as seen,
        closing(ordered_map(encoded, reel.steady(seen), workers=workers)) as parts,
    ):
        for done, part in enumerate(parts):
            for output, one in zip(outputs, part, strict=True):
                output.append(one)
            done_one(reel.numbers[done])


def _frame_count(source: VideoSource | ImageSequence, settings: VideoSettings) -> int | None:
    """How many frames there will be, if the file says so."""
    if source.frames_stated is None:
        return None
    first = source.files[0].number if isinstance(source, ImageSequence) else 0
    return settings.span.count(source.frames_stated, source.rate, first)


def _numbered(source: VideoSource | ImageSequence, settings: VideoSettings) -> Iterator[Frame]:
    """Frames with the rate and the numbers that their files will have."""
    shift: int | None = None
    rate = settings.span.rate(source.rate)
    for frame in source.frames(settings.span):
        if shift is None:
            wanted = settings.start_number
            shift = 0 if wanted is None else wanted - frame.index
        yield dataclasses.replace(frame, index=frame.index + shift, rate=rate)


def _scale(job: VideoJob, looks: WriterOptions) -> float | None:
    """Steps a metre in what is written with 16 bits."""
    is_stretched = looks.png_normalize and VideoFormat.PNG16 in job.names
    return None if is_stretched else looks.png_scale


def _nothing(job: VideoJob, source: VideoSource | ImageSequence) -> str:
    if source.problem:
        return f"{job.name} has no frame that can be read: {source.problem}"
    stated = source.frames_stated
    length = (
        "" if stated is None else f"; it has {stated} frames, {float(stated / source.rate):.3f} s"
    )
    return f"{job.name} has no frame between --start and --end{length}"
