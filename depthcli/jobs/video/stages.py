"""Writing a video: opening its outputs, processing the frames in stages, and the result."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from typing import Any

from depthcli.core.parallel import one_thread_each, ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import Frame
from depthcli.errors import InputError, Message, about
from depthcli.inference.camera import focal_warnings
from depthcli.inference.pipeline import Pipeline
from depthcli.io.formats.options import WriterOptions
from depthcli.io.guard import Guard
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.stored.sidecar import remove_video_sidecar
from depthcli.jobs.image import ImageJob
from depthcli.jobs.video.frames import (
    FrameClock,
    FrameFilter,
    FramePredictor,
    VideoReport,
    restored,
)
from depthcli.jobs.video.plan import VideoPlan, VideoResult
from depthcli.jobs.video.resume import open_journal, rounding_scale
from depthcli.known.frames import KnownDepthOfFrames
from depthcli.video.audio import AudioTrack
from depthcli.video.container import LiveStream
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.frames import FrameSource, Timing
from depthcli.video.numbering import base_name
from depthcli.video.outputs import (
    DepthFrame,
    SegmentedOutput,
    SequenceOutput,
    VideoOutput,
    video_file,
)
from depthcli.video.source import open_frames


def open_source(plan: VideoPlan) -> FrameSource:
    """The frames of a video; InputError if it cannot be read."""
    settings = plan.settings
    return open_frames(
        plan.source,
        rate=settings.fps,
        max_pixels=settings.max_pixels,
        options=settings.reading,
        stream=settings.stream,
    )


def write_video(
    plan: VideoPlan,
    source: FrameSource,
    pipeline: Pipeline,
    workers: int,
    progress: Progress = NO_PROGRESS,
) -> VideoResult:
    """Do as :func:`depthcli.jobs.video.run.video`, of an open video and with a loaded model.

    ``workers`` is the number of threads besides the one that decodes and writes.
    """
    start_s, settings = time.perf_counter(), plan.settings
    known_depth = KnownDepthOfFrames(
        settings.anchors, settings.anchors_fit, settings.anchors_within_s
    )
    with ExitStack() as stack:
        journal = stack.enter_context(open_journal(plan, source, pipeline, known_depth))
        overwrite = plan.request.overwrite or journal.is_resumed
        guard = Guard.of([*source.paths, *known_depth.paths], overwrite=overwrite)
        outputs = [*map(stack.enter_context, _outputs(plan, source, guard))]
        sidecar = None
        if VideoFormat.JSON in plan.names:
            sidecar = stack.enter_context(atomic_path(plan.path(VideoFormat.JSON), guard=guard))
        clock = FrameClock(source.rate, source.name_numbers, settings.start_number)
        scale = rounding_scale(plan, pipeline)
        predictor = FramePredictor(ImageJob(pipeline), settings, known_depth, journal, clock, scale)
        filter_ = FrameFilter(settings, predictor.kind)
        report = filter_.report
        advance = progress.begin(plan.name, source.count(settings.span), "frames")
        frames = clock.renumbered(source.frames(settings.span))
        ahead = workers if isinstance(plan.source, LiveStream) else None
        written = _process_frames(frames, predictor, filter_, outputs, workers, ahead)
        # Closed before the outputs, so that no thread writes into a file that is being removed.
        with closing(written) as numbers:
            for count, number in enumerate(numbers):
                if count == 0 and sidecar is None:
                    _remove_stale_sidecars(plan)
                journal.add(number)
                advance(1)
        if report.first is None:
            raise _no_frames(plan, source)
        if report.unfitted and len(report.unfitted) == len(report.numbers):
            raise InputError(report.unfitted[0])
        warnings = [warning for output in outputs for warning in output.finish()]
        done = _result(plan, source, pipeline, report, warnings)
        if sidecar is not None:
            is_numbered = not set(SEQUENCES).isdisjoint(plan.names)
            sidecar.write_text(done.sidecar(has_times=is_numbered), "utf-8")
    return replace(done, seconds=time.perf_counter() - start_s)


def _remove_stale_sidecars(plan: VideoPlan) -> None:
    """Remove the sidecar of an earlier run, which would state its camera for files without one."""
    for format_, name in plan.names.items():
        image = SEQUENCES.get(format_)
        if image is not None and not image.facts.has_camera:
            remove_video_sidecar(plan.folder / f"{base_name(name)}.json")


def _process_frames(
    frames: Iterator[Frame],
    predictor: FramePredictor,
    filter_: FrameFilter,
    outputs: Sequence[VideoOutput],
    workers: int,
    ahead: int | None,
) -> Generator[int, None, None]:
    """Process every frame in all stages, and yield its number once it is written.

    Each stage runs ``ahead`` frames ahead of the next; None for two for each worker.
    """

    def encoded(frame: DepthFrame) -> list[Any]:
        whole = restored(frame, predictor.settings)
        displayed = whole.displayed()
        return [output.encode(whole if output.has_overscan else displayed) for output in outputs]

    with (
        one_thread_each(workers),
        closing(
            ordered_map(predictor.predict, frames, workers=workers, ahead=ahead)
        ) as predictions,
        closing(
            ordered_map(encoded, filter_.smooth(predictions), workers=workers, ahead=ahead)
        ) as parts,
    ):
        for index, part in enumerate(parts):
            for output, data in zip(outputs, part, strict=True):
                output.append(data)
            yield filter_.report.numbers[index]


def _outputs(plan: VideoPlan, source: FrameSource, guard: Guard) -> Iterator[VideoOutput]:
    """The outputs of all formats but JSON, each in one file or in segments, and the page."""
    for format_ in plan.names:
        if format_ is not VideoFormat.JSON:
            opened = partial(open_output, format_, plan, source, guard)
            length_s = None if format_ in SEQUENCES else plan.settings.segment_s
            yield SegmentedOutput(opened, length_s, plan.first_segment) if length_s else opened()
    if plan.request.page is not None:
        yield plan.request.page


def open_output(
    format_: VideoFormat,
    plan: VideoPlan,
    source: FrameSource,
    guard: Guard,
    segment: int | None = None,
) -> VideoOutput:
    """The output of one format, or of one of its segments, to be entered."""
    request, writing = plan.request, plan.settings.writing
    if format_ in SEQUENCES:
        return SequenceOutput(SEQUENCES[format_], plan.folder, plan.names[format_], writing, guard)
    rate = plan.settings.span.rate(source.rate)
    step = source.rate / rate
    is_stepped = not source.numbers_follow_times and step.denominator == 1
    timing = Timing(rate, source.tick_s, source.rate, step.numerator if is_stepped else None)
    starts_s = source.start_s if request.has_audio else None
    audio = None
    if starts_s is not None and not isinstance(plan.source, LiveStream):
        audio = AudioTrack(plan.source, starts_s)
    target = plan.target(format_, segment)
    return video_file(format_, target, timing, guard, writing, request.codec, audio)


def _result(
    plan: VideoPlan,
    source: FrameSource,
    pipeline: Pipeline,
    report: VideoReport,
    warnings: Sequence[str],
) -> VideoResult:
    if report.first is None:
        raise TypeError(report)
    settings = plan.settings
    smooths = settings.smooth_s > 0
    is_fitted = bool(settings.anchors) and not report.unfitted
    camera_warnings = () if is_fitted else focal_warnings(pipeline.card, settings.camera)
    of_input = (*source.warnings, *report.warnings, *pipeline.session.warnings, *camera_warnings)
    of_input += _range_warnings(plan, settings.writing)
    if report.unfitted:
        problem = f"{len(report.unfitted)} of {len(report.numbers)} frames keep the model's depth"
        of_input += (about(problem, report.unfitted[0]),)
    return VideoResult(
        plan=plan,
        numbers=report.numbers,
        times_s=report.times_s,
        rate=settings.span.rate(source.rate),
        source_rate=source.rate,
        first=report.first[0],
        depth=report.first[1],
        flicker=(report.smoothed if smooths else report.raw).value,
        flicker_unsmoothed=report.raw.value if smooths else None,
        scenes=report.scenes,
        provider=pipeline.session.provider,
        seconds=0.0,
        warnings=(*of_input, *warnings),
        problem=source.problem,
        live=getattr(source, "counts", None),
    )


def _range_warnings(plan: VideoPlan, writing: WriterOptions) -> tuple[str, ...]:
    """A warning if normalized frames have no range in common, so that they flicker."""
    ranged = (format_.facts.range_options for format_ in plan.names)
    are_normalized = writing.is_normalized and any(ranged)
    if not are_normalized or None not in {writing.vmin, writing.vmax}:
        return ()
    problem = "the range of each frame is its own, so that equal depth has other numbers in another"
    return (Message(problem, "give {vmin} and {vmax} for one range"),)


def _no_frames(plan: VideoPlan, source: FrameSource) -> InputError:
    if source.problem:
        return InputError(f"{plan.name} has no frame that can be read: {source.problem}")
    problem = f"{plan.name} has no frame in the span"
    if source.numbers_stated is None:
        return InputError(problem)
    first, last = source.numbers_stated
    length_s = float((last - first + 1) / source.rate)
    advice = f"give other values of {{start}} and {{end}}; a frame number ends in f: {first}f"
    return InputError(f"{problem}; it has frames {first}–{last}, {length_s:.3f} s", advice)
