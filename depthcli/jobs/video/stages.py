"""The stages of a video's frames: prediction of each, filtering over time, and writing."""

from __future__ import annotations

import dataclasses
import time
from array import array
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from depthcli.core import temporal, types
from depthcli.core.anchors import AnchorPoints
from depthcli.core.arrays import Float32Array
from depthcli.core.parallel import one_thread_each, ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError, Message, about
from depthcli.inference.camera import focal_warnings
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.metadata import dequantized, quantized
from depthcli.io.formats.preview import percentiles
from depthcli.io.formats.sidecar import remove_video_sidecar
from depthcli.io.formats.table import WriterOptions
from depthcli.io.images.read import undistorted
from depthcli.io.storage.atomic import Guard, atomic_path
from depthcli.jobs.image import ImageJob, ImageResult, ImageTask
from depthcli.jobs.video.known_depth import FrameAnchors
from depthcli.jobs.video.plan import VideoPlan, VideoResult
from depthcli.jobs.video.resume import FrameJournal, open_journal, rounding_scale
from depthcli.video.audio import AudioTrack
from depthcli.video.container import LiveStream
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.frames import FrameSource, Timing
from depthcli.video.numbering import base_name, stamps_a_second
from depthcli.video.outputs import (
    DepthFrame,
    SegmentedOutput,
    SequenceOutput,
    VideoOutput,
    video_file,
)
from depthcli.video.source import open_frames


def write_video(
    plan: VideoPlan, pipeline: Pipeline, workers: int, progress: Progress = NO_PROGRESS
) -> VideoResult:
    """Do as :func:`depthcli.jobs.video.run.video`, with named outputs and a loaded model.

    ``workers`` is the number of threads besides the one that decodes and writes.
    """
    start_s, settings = time.perf_counter(), plan.settings
    source = open_frames(
        plan.source,
        rate=settings.fps,
        max_pixels=settings.max_pixels,
        options=settings.reading,
        stream=settings.stream,
    )
    with source, ExitStack() as stack:
        anchors = FrameAnchors(settings)
        journal = stack.enter_context(open_journal(plan, source, pipeline, anchors))
        overwrite = plan.request.overwrite or journal.is_resumed
        guard = Guard.of([*source.paths, *anchors.paths], overwrite=overwrite)
        outputs = [*map(stack.enter_context, _outputs(plan, source, guard))]
        sidecar = None
        if VideoFormat.JSON in plan.names:
            sidecar = stack.enter_context(atomic_path(plan.path(VideoFormat.JSON), guard=guard))
        stages = FrameStages(plan, pipeline, journal, anchors)
        advance = progress.begin(plan.name, source.count(settings.span), "frames")
        frames = stages.renumbered(source)
        ahead = workers if isinstance(plan.source, LiveStream) else None
        # Closed before the outputs, so that no thread writes into a file that is being removed.
        with closing(_process_frames(frames, stages, outputs, workers, ahead)) as numbers:
            for count, number in enumerate(numbers):
                if count == 0 and sidecar is None:
                    _remove_stale_sidecars(plan)
                journal.add(number)
                advance(1)
        if stages.first is None:
            raise _no_frames(plan, source)
        if stages.unfitted and len(stages.unfitted) == len(stages.numbers):
            raise InputError(stages.unfitted[0])
        warnings = [warning for output in outputs for warning in output.finish()]
        done = _result(plan, source, stages, warnings)
        if sidecar is not None:
            is_numbered = not set(SEQUENCES).isdisjoint(plan.names)
            sidecar.write_text(done.sidecar(has_times=is_numbered), "utf-8")
    return dataclasses.replace(done, seconds=time.perf_counter() - start_s)


def _remove_stale_sidecars(plan: VideoPlan) -> None:
    """Remove the sidecar of an earlier run, which would state its camera for files without one."""
    for which, name in plan.names.items():
        image = SEQUENCES.get(which)
        if image is not None and not image.facts.has_camera:
            remove_video_sidecar(plan.folder / f"{base_name(name)}.json")


def _process_frames(
    frames: Iterator[Frame],
    stages: FrameStages,
    outputs: Sequence[VideoOutput],
    workers: int,
    ahead: int | None,
) -> Generator[int, None, None]:
    """Process every frame in all stages, and yield its number once it is written.

    Each stage runs ``ahead`` frames ahead of the next; None for two for each worker.
    """

    def encoded(frame: DepthFrame) -> list[Any]:
        whole = stages.restore(frame)
        shown = whole.displayed()
        return [output.encode(whole if output.has_overscan else shown) for output in outputs]

    with (
        one_thread_each(workers),
        closing(ordered_map(stages.predict, frames, workers=workers, ahead=ahead)) as predicted,
        closing(
            ordered_map(encoded, stages.smooth(predicted), workers=workers, ahead=ahead)
        ) as parts,
    ):
        for index, part in enumerate(parts):
            for output, one in zip(outputs, part, strict=True):
                output.append(one)
            yield stages.numbers[index]


def _outputs(plan: VideoPlan, source: FrameSource, guard: Guard) -> Iterator[VideoOutput]:
    """The outputs of all formats but JSON, each in one file or in segments, and the page."""
    for which in plan.names:
        if which is not VideoFormat.JSON:
            opened = partial(open_output, which, plan, source, guard)
            length_s = None if which in SEQUENCES else plan.settings.segment_s
            yield SegmentedOutput(opened, length_s, plan.first_segment) if length_s else opened()
    if plan.request.page is not None:
        yield plan.request.page


def open_output(
    which: VideoFormat,
    plan: VideoPlan,
    source: FrameSource,
    guard: Guard,
    segment: int | None = None,
) -> VideoOutput:
    """The output of one format, or of one of its segments, to be entered."""
    request, writing = plan.request, plan.settings.writing
    if which in SEQUENCES:
        return SequenceOutput(SEQUENCES[which], plan.folder, plan.names[which], writing, guard)
    rate = plan.settings.span.rate(source.rate)
    step = source.rate / rate
    is_stepped = not source.numbers_follow_times and step.denominator == 1
    timing = Timing(rate, source.tick_s, source.rate, step.numerator if is_stepped else None)
    starts_s = source.start_s if request.has_audio else None
    audio = None
    if starts_s is not None and not isinstance(plan.source, LiveStream):
        audio = AudioTrack(plan.source, starts_s)
    target = plan.target(which, segment)
    return video_file(which, target, timing, guard, writing, request.codec, audio)


@dataclass(frozen=True, slots=True)
class PredictedFrame:
    """A frame after prediction, before the stages that depend on other frames."""

    #: the frame with its depth, of ``to_log`` if it is to be smoothed, and the depth's percentiles
    shown: DepthFrame
    #: why it is not fitted to known depth that the video has; None if it is
    unfitted: str | None
    thumbnail: Float32Array  #: its brightness at a reduced size, (h, w) float32
    sampled: Float32Array  #: its depth at that size, (h, w) of ``to_log``
    warnings: tuple[str, ...] = ()  #: about its depth, one line each


class FrameStages:
    """The stages of each frame, and the state between frames."""

    def __init__(
        self, plan: VideoPlan, pipeline: Pipeline, journal: FrameJournal, anchors: FrameAnchors
    ) -> None:
        """Begin before the first frame; the journal has frames that an earlier run wrote."""
        self._journal, self._scale = journal, rounding_scale(plan, pipeline)
        self.pipeline, self._settings, self._anchors = pipeline, plan.settings, anchors
        self._job = ImageJob(pipeline)
        self._shift, self._source_rate = 0, 1.0  # of numbers; frames a second
        self._first_number: int | None = None
        self._name_numbers: Sequence[int] = ()
        self._changes = temporal.ChangeDetector()
        self._lock = temporal.RangeLock()
        self._deflicker = temporal.Deflicker(plan.settings.look_ahead)
        self._smoother = temporal.Smoother()
        self._kind = kind = DepthKind.METRIC if plan.settings.anchors else pipeline.card.output.kind
        self.unfitted: list[str] = []
        self.raw, self.smoothed = temporal.FlickerMeter(kind), temporal.FlickerMeter(kind)
        self.scenes = 0
        self.first: tuple[Frame, DepthMap] | None = None
        self.warnings: tuple[str, ...] = ()  # about the depth of the first frame
        self.times_s = array("d")
        self.numbers = array("q")

    def renumbered(self, source: FrameSource) -> Iterator[Frame]:
        """The frames with the output's numbers, and the rate that these count."""
        wanted = self._settings.start_number
        self._source_rate, self._name_numbers = float(source.rate), source.name_numbers
        for count, frame in enumerate(source.frames(self._settings.span)):
            if count == 0:
                self._shift = 0 if wanted is None else wanted - frame.index
                self._first_number = frame.index + self._shift
            yield dataclasses.replace(frame, index=frame.index + self._shift, rate=source.rate)

    def predict(self, image: Frame) -> PredictedFrame:
        """Predict a frame, and all that depends on one frame only; thread-safe."""
        camera = self._settings.camera
        aspect = camera.pixel_aspect or image.pixel_aspect
        image = undistorted(dataclasses.replace(image, pixel_aspect=aspect), camera)
        kept, warnings = self._journal.depth(image.index), tuple[str, ...]()
        unfitted = None
        if kept is not None and image.index != self._first_number:  # predicted, for the report
            depth = DepthMap(kept, self._kind)
        else:
            kept = None
            done, unfitted = self._fitted(types.seen_frame(image))
            depth, of_video = done.whole, {*done.shared, *image.warnings}
            warnings = tuple(text for text in done.warnings if text not in of_video)
            if self._scale is not None:
                values = dequantized(quantized(depth.values, self._scale)[0], self._scale)
                depth = dataclasses.replace(depth, values=values)
        depth, shown = _in_windows(depth, image.windows, is_kept=kept is not None)
        small_image = temporal.thumbnail(image.pixels)
        small = DepthMap(temporal.sample_cells(shown, small_image.shape), depth.kind)
        if self._settings.smooth_s:
            depth = dataclasses.replace(depth, values=temporal.to_log(depth))
        frame = DepthFrame(image, depth, percentiles(small), is_kept=kept is not None)
        return PredictedFrame(frame, unfitted, small_image, temporal.to_log(small), warnings)

    def _fitted(self, image: Frame) -> tuple[ImageResult, str | None]:
        """Depth of a frame, and why it is not fitted to known depth, if the video has any."""
        if not self._settings.anchors:
            return self._run(image, None), None
        number, time_s = image.index - self._shift, image.timestamp_s or 0.0
        named = self._name_numbers[number] if self._name_numbers else number
        stamps = stamps_a_second(named) if self._name_numbers else None
        try:
            points = self._anchors.of_frame(named, time_s, self._source_rate, stamps)
            if points is not None:
                return self._run(image, points), None
            advice = "{anchors_within} takes that of the nearest time"
            problem: str = Message(f"frame {number} has no known depth", advice)
        except InputError as error:
            problem = about(f"frame {number}", error.message)
        if self.pipeline.card.output.kind is not DepthKind.METRIC:
            raise InputError(problem, "give some for every frame, or another {model}")
        return self._run(image, None), problem

    def _run(self, image: Frame, points: AnchorPoints | None) -> ImageResult:
        return self._job.run(ImageTask(image, self._settings.camera, points))

    def smooth(self, frames: Iterable[PredictedFrame]) -> Iterator[DepthFrame]:
        """The stages that need the frames in order; fast, in one thread."""
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
    ) -> DepthFrame:
        """A frame with smoothed depth and colour range, and its share of the report."""
        image, now_s = frame.shown.image, frame.shown.time_s
        interval_s = now_s - self.times_s[-1] if self.times_s else 0.0
        self.times_s.append(now_s)
        self.numbers.append(image.index)
        if frame.unfitted:
            self.unfitted.append(frame.unfitted)
        if self.first is None:
            shown = self.restore(frame.shown).displayed()
            alone = dataclasses.replace(shown.image, pixels=np.zeros((1, 1), np.uint8))
            self.first = (alone, shown.depth)
            self.warnings = tuple(about(f"frame {image.index}", w) for w in frame.warnings)
        self.scenes += change.is_cut
        decay = temporal.ema_decay(interval_s, self._settings.lock_s)
        spread = self._lock.step(*frame.shown.spread, decay, is_cut=change.is_cut)
        self.raw.step(frame.sampled, change)
        depth = frame.shown.depth
        if correction is not None:
            decay = temporal.ema_decay(interval_s, self._settings.smooth_s)
            steps = self._smoother.step(depth.values, change, correction, decay)
            self.smoothed.step(temporal.sample_cells(steps, frame.thumbnail.shape), change)
            depth = dataclasses.replace(depth, values=steps)
        return dataclasses.replace(frame.shown, depth=depth, spread=spread)

    def restore(self, frame: DepthFrame) -> DepthFrame:
        """Convert the smoother's output back to depth; thread-safe."""
        if not self._settings.smooth_s:
            return frame
        depth = frame.depth
        values = temporal.from_log(depth.values, depth.kind)
        return dataclasses.replace(frame, depth=dataclasses.replace(depth, values=values))


def _in_windows(
    depth: DepthMap, windows: types.Windows | None, *, is_kept: bool
) -> tuple[DepthMap, Float32Array]:
    """Depth over all pixels of its frame, without any where the file has no pixels.

    What an earlier run wrote (kept) covers the display window alone. Also returns the values
    without overscan, (H, W) float32 of the same size.
    """
    if windows is None:
        return depth, depth.values
    covered = windows.display if is_kept else windows.seen
    values = types.over_window(depth.values, covered, windows.pixels)
    depth = types.masked_to_data_window(dataclasses.replace(depth, values=values), windows)
    return depth, windows.only(windows.display, depth.values)


def _result(
    plan: VideoPlan, source: FrameSource, stages: FrameStages, warnings: Sequence[str]
) -> VideoResult:
    if stages.first is None:
        raise TypeError(stages)
    pipeline, settings = stages.pipeline, plan.settings
    smooths = settings.smooth_s > 0
    is_fitted = bool(settings.anchors) and not stages.unfitted
    camera_warnings = () if is_fitted else focal_warnings(pipeline.card, settings.camera)
    of_input = (*source.warnings, *stages.warnings, *pipeline.session.warnings, *camera_warnings)
    of_input += _range_warnings(plan, settings.writing)
    if stages.unfitted:
        told = f"{len(stages.unfitted)} of {len(stages.numbers)} frames keep the model's depth"
        of_input += (about(told, stages.unfitted[0]),)
    return VideoResult(
        plan=plan,
        numbers=stages.numbers,
        times_s=stages.times_s,
        rate=settings.span.rate(source.rate),
        source_rate=source.rate,
        first=stages.first[0],
        depth=stages.first[1],
        flicker=(stages.smoothed if smooths else stages.raw).value,
        flicker_unsmoothed=stages.raw.value if smooths else None,
        scenes=stages.scenes,
        provider=pipeline.session.provider,
        seconds=0.0,
        warnings=(*of_input, *warnings),
        problem=source.problem,
        live=getattr(source, "counts", None),
    )


def _range_warnings(plan: VideoPlan, writing: WriterOptions) -> tuple[str, ...]:
    """A warning if normalized frames have no range in common, so that they flicker."""
    images = [which.facts.image for which in plan.names]
    are_normalized = writing.is_normalized and any(i and i.facts.range_options for i in images)
    if not are_normalized or None not in {writing.vmin, writing.vmax}:
        return ()
    told = "the range of each frame is its own, so that equal depth has other numbers in another"
    return (Message(told, "give {vmin} and {vmax} for one range"),)


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
