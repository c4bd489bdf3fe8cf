"""Writing a video: its frames predicted, smoothed in order and written, and the result."""

import time
from array import array
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core import temporal, types
from depthcli.core.parallel import NO_PROGRESS, Progress, one_thread_each, ordered_map
from depthcli.errors import InputError, Message, about
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.transforms import focal_warnings
from depthcli.io.formats.preview import percentiles
from depthcli.io.guard import Guard
from depthcli.io.images.read import undistorted
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.stored.depth import remove_video_sidecar
from depthcli.io.stored.metadata import dequantized, quantized
from depthcli.jobs.image import ImageJob, ImageResult, ImageTask
from depthcli.jobs.video.plan import VideoPlan, VideoResult, VideoSettings
from depthcli.jobs.video.resume import FrameJournal, open_journal, rounding_scale
from depthcli.known.sources import KnownDepthOfFrames
from depthcli.video import container, formats, numbering, outputs
from depthcli.video.audio import AudioTrack
from depthcli.video.frames import FrameSource, Timing
from depthcli.video.source import open_frames

_STAMPS_A_SECOND = {13: 10**3, 16: 10**6, 19: 10**9}  #: by the digits of times since 1970


@dataclass(frozen=True, slots=True)
class PredictedFrame:
    """A frame after prediction, before the stages that depend on other frames."""

    #: the frame with its depth, of ``to_log`` if it is to be smoothed, and the depth's percentiles
    shown: outputs.DepthFrame
    #: why it is not fitted to known depth that the video has; None if it is
    unfitted: str | None
    thumbnail: types.Float32Array  #: its brightness at a reduced size, (h, w) float32
    sampled: types.Float32Array  #: its depth at that size, (h, w) of ``to_log``
    warnings: tuple[str, ...] = ()  #: about its depth, one line each


@dataclass(frozen=True, slots=True)
class FramePredictor:
    """Predicts frames, in any order; thread-safe."""

    job: ImageJob  #: the model
    settings: VideoSettings
    known: KnownDepthOfFrames  #: known depth of the frames
    journal: FrameJournal  #: frames that an earlier run wrote
    source: FrameSource  #: where the frames come from
    first: int  #: number of its first frame
    scale: float | None  #: units per metre to which depth is rounded; None for no rounding

    @property
    def kind(self) -> types.DepthKind:
        """What the values of the maps mean."""
        is_fitted = bool(self.settings.anchors)
        return types.DepthKind.METRIC if is_fitted else self.job.pipeline.card.output.kind

    def predict(self, image: types.Frame) -> PredictedFrame:
        """Predict a frame, and all that depends on one frame only."""
        number, start, camera = image.index, self.settings.start_number, self.settings.camera
        shift = 0 if start is None else start - self.first
        aspect = camera.pixel_aspect or image.pixel_aspect
        image = replace(image, index=number + shift, rate=self.source.rate, pixel_aspect=aspect)
        image = undistorted(image, camera)
        # The first frame is always predicted, for the report.
        written = self.journal.depth(image.index) if number != self.first else None
        unfitted, warnings = None, tuple[str, ...]()
        if written is not None:
            depth = types.DepthMap(written, self.kind)
        else:
            done, unfitted = self._fitted(types.seen_frame(image), number)
            depth, of_video = done.whole, {*done.shared, *image.warnings}
            warnings = tuple(text for text in done.warnings if text not in of_video)
            if self.scale is not None:
                values = dequantized(quantized(depth.values, self.scale)[0], self.scale)
                depth = replace(depth, values=values)
        depth, displayed = _in_windows(depth, image.windows, is_kept=written is not None)
        thumbnail = temporal.thumbnail(image.pixels)
        small = types.DepthMap(temporal.sample_cells(displayed, thumbnail.shape), depth.kind)
        if self.settings.smooth_s:
            depth = replace(depth, values=temporal.to_log(depth))
        frame = outputs.DepthFrame(image, depth, percentiles(small), is_kept=written is not None)
        return PredictedFrame(frame, unfitted, thumbnail, temporal.to_log(small), warnings)

    def _fitted(self, image: types.Frame, number: int) -> tuple[ImageResult, str | None]:
        """Depth of a frame, and why it is not fitted to known depth, if the video has any."""
        task = ImageTask(image, self.settings.camera)
        if not self.settings.anchors:
            return self.job.run(task), None
        names = self.source.name_numbers
        named = names[number] if names else number
        stamps = _STAMPS_A_SECOND.get(len(str(named))) if names else None
        try:
            points = self.known.of_frame(
                named, image.timestamp_s or 0.0, float(self.source.rate), stamps
            )
            if points is not None:
                return self.job.run(task._replace(points=points)), None
            advice = "{anchors_within} takes that of the nearest time"
            problem: str = Message(f"frame {number} has no known depth", advice)
        except InputError as error:
            problem = about(f"frame {number}", error.message)
        if self.job.pipeline.card.output.kind is not types.DepthKind.METRIC:
            raise InputError(problem, "give some for every frame, or another {model}")
        return self.job.run(task), problem


class FrameFilter:
    """Smooths frames and the preview's range over time, and reports on them; in one thread.

    Attributes:
        raw: flicker of the depth before smoothing.
        smoothed: that after it.
        first: the first frame with its depth, as they are written, without pixels.
        warnings: about the depth of the first frame, one line each.
        unfitted: why frames are not fitted to known depth.
        scenes: how many there are so far.
        times_s: time of each frame.
        numbers: number of each.
    """

    first: outputs.DepthFrame

    def __init__(self, settings: VideoSettings, kind: types.DepthKind) -> None:
        """Begin before the first frame."""
        self._settings = settings
        self._changes, self._lock = temporal.ChangeDetector(), temporal.RangeLock()
        self._deflicker = temporal.Deflicker(settings.look_ahead)
        self._smoother = temporal.Smoother()
        self.raw, self.smoothed = temporal.FlickerMeter(kind), temporal.FlickerMeter(kind)
        self.warnings, self.unfitted, self.scenes = tuple[str, ...](), list[str](), 0
        self.times_s, self.numbers = array("d"), array("q")

    def smooth(self, frames: Iterable[PredictedFrame]) -> Iterator[outputs.DepthFrame]:
        """The stages that need the frames in order; fast."""
        if not self._settings.smooth_s:
            for frame in frames:
                yield self._finished(frame, self._changes.step(frame.thumbnail), None)
            return
        waiting: deque[tuple[PredictedFrame, temporal.Change]] = deque()
        before_s = 0.0
        for frame in frames:
            change, now_s = self._changes.step(frame.thumbnail), frame.shown.time_s
            decay = temporal.ema_decay(now_s - before_s, self._settings.smooth_s)
            before_s = now_s
            waiting.append((frame, change))
            for correction in self._deflicker.step(
                frame.thumbnail, frame.sampled, decay, is_cut=change.is_cut
            ):
                yield self._finished(*waiting.popleft(), correction)
        for correction in self._deflicker.finish():
            yield self._finished(*waiting.popleft(), correction)

    def _finished(
        self, frame: PredictedFrame, change: temporal.Change, correction: temporal.Correction | None
    ) -> outputs.DepthFrame:
        """A frame with smoothed depth and colour range, and its share of the report."""
        shown, now_s = frame.shown, frame.shown.time_s
        interval_s = now_s - self.times_s[-1] if self.times_s else 0.0
        if not self.times_s:
            first = restored(shown, self._settings).displayed()
            pixels = np.zeros((1, 1), np.uint8)
            self.first = replace(first, image=replace(first.image, pixels=pixels))
            number = shown.image.index
            self.warnings = tuple(about(f"frame {number}", text) for text in frame.warnings)
        self.times_s.append(now_s)
        self.numbers.append(shown.image.index)
        if frame.unfitted:
            self.unfitted.append(frame.unfitted)
        self.scenes += change.is_cut
        decay = temporal.ema_decay(interval_s, self._settings.lock_s)
        spread = self._lock.step(*shown.spread, decay, is_cut=change.is_cut)
        self.raw.step(frame.sampled, change)
        depth = shown.depth
        if correction is not None:
            decay = temporal.ema_decay(interval_s, self._settings.smooth_s)
            steps = self._smoother.step(depth.values, change, correction, decay)
            self.smoothed.step(temporal.sample_cells(steps, frame.thumbnail.shape), change)
            depth = replace(depth, values=steps)
        return replace(shown, depth=depth, spread=spread)


def restored(frame: outputs.DepthFrame, settings: VideoSettings) -> outputs.DepthFrame:
    """Convert the smoother's output back to depth; thread-safe."""
    if not settings.smooth_s:
        return frame
    depth = frame.depth
    values = temporal.from_log(depth.values, depth.kind)
    return replace(frame, depth=replace(depth, values=values))


def _in_windows(
    depth: types.DepthMap, windows: types.Windows | None, *, is_kept: bool
) -> tuple[types.DepthMap, types.Float32Array]:
    """Depth over all pixels of its frame, without any where the file has no pixels.

    What an earlier run wrote (kept) covers the display window alone. Also returns the values
    without overscan, (H, W) float32 of the same size.
    """
    if windows is None:
        return depth, depth.values
    covered = windows.display if is_kept else windows.seen
    values = types.over_window(depth.values, covered, windows.pixels)
    depth = types.masked_to_data_window(replace(depth, values=values), windows)
    return depth, windows.only(windows.display, depth.values)


def write_video(
    plan: VideoPlan, pipeline: Pipeline, workers: int, progress: Progress = NO_PROGRESS
) -> VideoResult:
    """Do as :func:`depthcli.jobs.video.run.video`, of a local video and with a loaded model.

    ``workers`` is the number of threads besides the one that decodes and writes.
    """
    start_s, settings = time.perf_counter(), plan.settings
    with ExitStack() as stack:
        source = stack.enter_context(
            open_frames(
                plan.source,
                rate=settings.fps,
                max_pixels=settings.max_pixels,
                options=settings.reading,
                stream=settings.stream,
            )
        )
        known_depth = KnownDepthOfFrames(
            settings.anchors, settings.anchors_fit, settings.anchors_within_s
        )
        journal = stack.enter_context(open_journal(plan, source, pipeline, known_depth))
        overwrite = plan.request.overwrite or journal.is_resumed
        guard = Guard.of([*source.paths, *known_depth.paths], overwrite=overwrite)
        writers = [*map(stack.enter_context, _outputs(plan, source, guard))]
        sidecar = None
        if formats.VideoFormat.JSON in plan.names:
            path = plan.path(formats.VideoFormat.JSON)
            guard.check(path)
            sidecar = stack.enter_context(atomic_path(path))
        advance = progress.begin(plan.name, source.count(settings.span), "frames")
        frames = source.frames(settings.span)
        first = next(frames, None)
        if first is None:
            raise _no_frames(plan, source)
        scale, job = rounding_scale(plan, pipeline), ImageJob(pipeline)
        how = (settings, known_depth, journal, source, first.index, scale)
        predictor = FramePredictor(job, *how)
        report = FrameFilter(settings, predictor.kind)
        ahead = workers if isinstance(plan.source, container.LiveStream) else None
        frames = chain([first], frames)
        written = _process_frames(frames, predictor, report, writers, workers, ahead)
        # Closed before the outputs, so that no thread writes into a file that is being removed.
        with closing(written) as numbers:
            for count, number in enumerate(numbers):
                if count == 0 and sidecar is None:
                    _remove_stale_sidecars(plan)
                journal.add(number)
                advance(1)
        if report.unfitted and len(report.unfitted) == len(report.numbers):
            raise InputError(report.unfitted[0])
        warnings = [warning for output in writers for warning in output.finish()]
        done = _result(plan, source, pipeline, report, warnings)
        if sidecar is not None:
            is_numbered = not set(formats.SEQUENCES).isdisjoint(plan.names)
            sidecar.write_text(done.sidecar(has_times=is_numbered), "utf-8")
    return replace(done, seconds=time.perf_counter() - start_s)


def _remove_stale_sidecars(plan: VideoPlan) -> None:
    """Remove the sidecar of an earlier run, which would state its camera for files without one."""
    for format_, name in plan.names.items():
        image = formats.SEQUENCES.get(format_)
        if image is not None and not image.facts.has_camera:
            remove_video_sidecar(plan.folder / f"{numbering.base_name(name)}.json")


def _process_frames(
    frames: Iterator[types.Frame],
    predictor: FramePredictor,
    filter_: FrameFilter,
    writers: Sequence[outputs.VideoOutput],
    workers: int,
    ahead: int | None,
) -> Generator[int, None, None]:
    """Process every frame in all stages, and yield its number once it is written.

    Each stage runs ``ahead`` frames ahead of the next; None for two for each worker.
    """

    def encoded(frame: outputs.DepthFrame) -> list[Any]:
        whole = restored(frame, predictor.settings)
        displayed = whole.displayed()
        return [output.encode(whole if output.has_overscan else displayed) for output in writers]

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
            for output, data in zip(writers, part, strict=True):
                output.append(data)
            yield filter_.numbers[index]


def _outputs(plan: VideoPlan, source: FrameSource, guard: Guard) -> Iterator[outputs.VideoOutput]:
    """The outputs of all formats but JSON, each in one file or in segments, and the page."""
    for format_ in plan.names:
        if format_ is not formats.VideoFormat.JSON:
            opened = partial(open_output, format_, plan, source, guard)
            length_s = None if format_ in formats.SEQUENCES else plan.settings.segment_s
            yield (
                outputs.SegmentedOutput(opened, length_s, plan.first_segment)
                if length_s
                else opened()
            )
    if plan.request.page is not None:
        yield plan.request.page


def open_output(
    format_: formats.VideoFormat,
    plan: VideoPlan,
    source: FrameSource,
    guard: Guard,
    segment: int | None = None,
) -> outputs.VideoOutput:
    """The output of one format, or of one of its segments, to be entered."""
    request, writing = plan.request, plan.settings.writing
    if format_ in formats.SEQUENCES:
        return outputs.SequenceOutput(
            formats.SEQUENCES[format_], plan.folder, plan.names[format_], writing, guard
        )
    rate = plan.settings.span.rate(source.rate)
    step = source.rate / rate
    is_stepped = not source.numbers_follow_times and step.denominator == 1
    timing = Timing(rate, source.tick_s, source.rate, step.numerator if is_stepped else None)
    starts_s = source.start_s if request.has_audio else None
    audio = None
    if starts_s is not None and not isinstance(plan.source, container.LiveStream):
        audio = AudioTrack(plan.source, starts_s)
    target = plan.target(format_, segment)
    if isinstance(target, Path):
        guard.check(target)
    return outputs.video_file(format_, target, timing, writing, request.codec, audio)


def _result(
    plan: VideoPlan,
    source: FrameSource,
    pipeline: Pipeline,
    report: FrameFilter,
    warnings: Sequence[str],
) -> VideoResult:
    settings = plan.settings
    smooths = settings.smooth_s > 0
    is_fitted = bool(settings.anchors) and not report.unfitted
    camera_warnings = () if is_fitted else focal_warnings(pipeline.card, settings.camera)
    of_input = (*source.warnings, *report.warnings, *pipeline.session.warnings, *camera_warnings)
    writing = settings.writing
    is_ranged = writing.is_normalized and any(kind.facts.range_options for kind in plan.names)
    if is_ranged and None in {writing.vmin, writing.vmax}:  # so that frames flicker
        problem = "the range of each frame is its own, so that equal depth has other numbers in "
        of_input += (Message(f"{problem}another", "give {vmin} and {vmax} for one range"),)
    if report.unfitted:
        problem = f"{len(report.unfitted)} of {len(report.numbers)} frames keep the model's depth"
        of_input += (about(problem, report.unfitted[0]),)
    return VideoResult(
        plan=plan,
        numbers=report.numbers,
        times_s=report.times_s,
        rate=settings.span.rate(source.rate),
        source_rate=source.rate,
        first=report.first.image,
        depth=report.first.depth,
        flicker=(report.smoothed if smooths else report.raw).value,
        flicker_unsmoothed=report.raw.value if smooths else None,
        scenes=report.scenes,
        provider=pipeline.session.provider,
        seconds=0.0,
        warnings=(*of_input, *warnings),
        problem=source.problem,
        live=getattr(source, "counts", None),
    )


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
