"""Processing the frames of a planned video, and writing its outputs."""

import dataclasses
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing
from fractions import Fraction
from pathlib import Path
from typing import Any

from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, OutputError
from depthcli.inference.camera import focal_warnings
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.sidecar import remove_video_sidecar
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.guard import Guard
from depthcli.jobs.outputs import output_guard
from depthcli.jobs.video.outputs import open_output
from depthcli.jobs.video.plan import VideoPlan
from depthcli.jobs.video.request import VideoSettings
from depthcli.jobs.video.result import VideoResult
from depthcli.jobs.video.resume import earlier_frames, rounding_scale
from depthcli.jobs.video.stages import FrameStages
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.frame_source import open_frames
from depthcli.video.frames import FrameSource
from depthcli.video.number_pattern import base_name
from depthcli.video.output import DepthFrame, VideoOutput

_ON_GRID = 1e-6


def write_video(
    plan: VideoPlan,
    pipeline: Pipeline,
    settings: VideoSettings,
    workers: int,
    progress: Progress = NO_PROGRESS,
) -> VideoResult:
    """As :func:`depthcli.jobs.video.run.video`, with named outputs and a loaded model.

    ``workers`` is the number of threads besides the one that decodes and writes.

    Raises:
        InputError: the video cannot be read, or has no frame in the span.
        OutputError: an output cannot be written.
        ModelError: the network failed.
        UsageError: the options do not fit the model.
    """
    start_s = time.perf_counter()
    for which in plan.names:
        if plan.path(which).is_dir():
            raise OutputError(f"{plan.path(which)} is a folder", "choose another {out}")
    with (
        open_frames(
            plan.source,
            rate=settings.fps,
            max_pixels=settings.max_pixels,
            options=settings.reading,
        ) as source,
        ExitStack() as stack,
    ):
        rate = settings.span.rate(source.rate)
        earlier = stack.enter_context(earlier_frames(plan, source, pipeline, settings))
        guard = output_guard(source.paths, overwrite=plan.overwrite or earlier.is_resumed)
        outputs = [
            stack.enter_context(open_output(which, plan, settings.writing, source, rate, guard))
            for which in plan.names
            if which is not VideoFormat.JSON
        ]
        sidecar = _sidecar(plan, guard, stack)
        scale = rounding_scale(plan, pipeline, settings)
        stages = FrameStages(pipeline, settings, earlier.kept, scale)
        advance = progress.begin(plan.name, source.count(settings.span), "frames")
        frames = _renumbered(source, settings)
        # Closed before the outputs, so that no thread writes into a file that is being removed.
        with closing(_process_frames(frames, stages, outputs, workers)) as numbers:
            for count, number in enumerate(numbers):
                if count == 0 and VideoFormat.NPY in plan.names and sidecar is None:
                    _remove_stale_sidecar(plan)
                earlier.add(number)
                advance(1)
        if stages.first is None:
            raise InputError(_no_frames_text(plan, source))
        done = _video_done(plan, pipeline, settings, source, stages, stages.first)
        warnings = [warning for output in outputs for warning in output.finish()]
        if sidecar is not None:
            is_numbered = not set(SEQUENCES).isdisjoint(plan.names)
            sidecar.write_text(done.sidecar(has_times=is_numbered), "utf-8")
    seconds = time.perf_counter() - start_s
    return dataclasses.replace(done, seconds=seconds, warnings=(*done.warnings, *warnings))


def _remove_stale_sidecar(plan: VideoPlan) -> None:
    """Remove the sidecar of an earlier run, which would state its camera for files without one."""
    base = base_name(plan.names[VideoFormat.NPY])
    remove_video_sidecar(plan.folder / f"{base}.json")


def _sidecar(plan: VideoPlan, guard: Guard, stack: ExitStack) -> Path | None:
    """Temporary path of the JSON file; None if it is not an output."""
    if VideoFormat.JSON not in plan.names:
        return None
    return stack.enter_context(atomic_path(plan.path(VideoFormat.JSON), guard=guard))


def _process_frames(
    frames: Iterator[Frame], stages: FrameStages, outputs: Sequence[VideoOutput], workers: int
) -> Generator[int, None, None]:
    """Process every frame in all stages; each stage runs a few frames ahead of the next.

    Yields:
        The number of each frame once it is written.
    """

    def encoded(frame: DepthFrame) -> list[Any]:
        whole = stages.restore(frame)
        shown = whole.displayed()
        return [output.encode(whole if output.has_overscan else shown) for output in outputs]

    with (
        one_thread_each(workers),
        closing(ordered_map(stages.predict, frames, workers=workers)) as predicted,
        closing(ordered_map(encoded, stages.smooth(predicted), workers=workers)) as parts,
    ):
        for index, part in enumerate(parts):
            for output, one in zip(outputs, part, strict=True):
                output.append(one)
            yield stages.numbers[index]


def _renumbered(source: FrameSource, settings: VideoSettings) -> Iterator[Frame]:
    """The frames with the output's rate and frame numbers."""
    shift: int | None = None
    rate = settings.span.rate(source.rate)
    for frame in source.frames(settings.span):
        if shift is None:
            wanted = settings.start_number
            shift = 0 if wanted is None else wanted - frame.index
        yield dataclasses.replace(frame, index=frame.index + shift, rate=rate)


def _video_done(
    plan: VideoPlan,
    pipeline: Pipeline,
    settings: VideoSettings,
    source: FrameSource,
    stages: FrameStages,
    first: tuple[Frame, DepthMap],
) -> VideoResult:
    """The result, without the time and the warnings of the outputs."""
    rate, smooths = settings.span.rate(source.rate), settings.smooth_s > 0
    is_stretched = settings.writing.png_normalize and VideoFormat.PNG16 in plan.names
    return VideoResult(
        name=plan.name,
        outputs=tuple(str(plan.path(which)) for which in plan.names),
        numbers=stages.numbers,
        times_s=stages.times_s,
        rate=rate,
        source_rate=source.rate,
        is_regular=_is_regular(stages.times_s, rate),
        first=first[0],
        depth=first[1],
        flicker=(stages.smoothed if smooths else stages.raw).value,
        flicker_unsmoothed=stages.raw.value if smooths else None,
        scenes=stages.scenes,
        smooth_s=settings.smooth_s,
        lock_s=settings.lock_s,
        scale=None if is_stretched else settings.writing.png_scale,
        provider=pipeline.session.provider,
        seconds=0.0,
        warnings=(
            *source.warnings,
            *pipeline.session.warnings,
            *focal_warnings(pipeline.card, settings.camera),
        ),
        problem=source.problem,
    )


def _is_regular(times_s: Sequence[float], rate: Fraction) -> bool:
    """Whether the timestamps are those of a constant frame rate."""
    return all(abs((t - times_s[0]) * rate - i) < _ON_GRID for i, t in enumerate(times_s))


def _no_frames_text(plan: VideoPlan, source: FrameSource) -> str:
    if source.problem:
        return f"{plan.name} has no frame that can be read: {source.problem}"
    what = f"{plan.name} has no frame between --start and --end"
    if source.numbers_stated is None:
        return what
    first, last = source.numbers_stated
    length_s = float((last - first + 1) / source.rate)
    span = f"{first}–{last}, {length_s:.3f} s"
    return f"{what}; it has frames {span}; a frame number ends in f: {first}f"
