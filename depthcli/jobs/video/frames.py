"""A frame of a video as a value: predicted, smoothed in order, and restored to depth."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np

from depthcli.core import temporal, types
from depthcli.core.arrays import Float32Array
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError, Message, about
from depthcli.io.formats.preview import percentiles
from depthcli.io.images.read import undistorted
from depthcli.io.stored.metadata import dequantized, quantized
from depthcli.jobs.image import ImageJob, ImageResult, ImageTask
from depthcli.jobs.video.plan import VideoSettings
from depthcli.jobs.video.resume import FrameJournal
from depthcli.known.frames import KnownDepthOfFrames
from depthcli.known.points import KnownDepth
from depthcli.video.numbering import stamps_a_second
from depthcli.video.outputs import DepthFrame


@dataclass(slots=True)
class FrameClock:
    """Numbers of the frames, in the input and in the outputs."""

    rate: Fraction  #: frames a second of the input
    name_numbers: Sequence[int] = ()  #: of images that are numbered by their times
    start: int | None = None  #: number of the first frame in the outputs; None for the input's
    first: int | None = None  #: that number, once it is known
    _shift: int = 0

    def renumbered(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames with the output's numbers, and the rate that these count."""
        for frame in frames:
            if self.first is None:
                self._shift = 0 if self.start is None else self.start - frame.index
                self.first = frame.index + self._shift
            yield replace(frame, index=frame.index + self._shift, rate=self.rate)

    def input_number(self, frame: Frame) -> int:
        """The number of a renumbered frame in the input; the first of the file has 0."""
        return frame.index - self._shift


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


@dataclass(frozen=True, slots=True)
class FramePredictor:
    """Predicts frames, in any order; thread-safe."""

    job: ImageJob  #: the model
    settings: VideoSettings
    known: KnownDepthOfFrames  #: known depth of the frames
    journal: FrameJournal  #: frames that an earlier run wrote
    clock: FrameClock
    scale: float | None  #: units per metre to which depth is rounded; None for no rounding

    @property
    def kind(self) -> DepthKind:
        """What the values of the maps mean."""
        is_fitted = bool(self.settings.anchors)
        return DepthKind.METRIC if is_fitted else self.job.pipeline.card.output.kind

    def predict(self, image: Frame) -> PredictedFrame:
        """Predict a frame, and all that depends on one frame only."""
        camera = self.settings.camera
        aspect = camera.pixel_aspect or image.pixel_aspect
        image = undistorted(replace(image, pixel_aspect=aspect), camera)
        # The first frame is always predicted, for the report.
        written = self.journal.depth(image.index) if image.index != self.clock.first else None
        unfitted, warnings = None, tuple[str, ...]()
        if written is not None:
            depth = DepthMap(written, self.kind)
        else:
            done, unfitted = self._fitted(types.seen_frame(image))
            depth, of_video = done.whole, {*done.shared, *image.warnings}
            warnings = tuple(text for text in done.warnings if text not in of_video)
            if self.scale is not None:
                values = dequantized(quantized(depth.values, self.scale)[0], self.scale)
                depth = replace(depth, values=values)
        depth, displayed = _in_windows(depth, image.windows, is_kept=written is not None)
        thumbnail = temporal.thumbnail(image.pixels)
        small = DepthMap(temporal.sample_cells(displayed, thumbnail.shape), depth.kind)
        if self.settings.smooth_s:
            depth = replace(depth, values=temporal.to_log(depth))
        frame = DepthFrame(image, depth, percentiles(small), is_kept=written is not None)
        return PredictedFrame(frame, unfitted, thumbnail, temporal.to_log(small), warnings)

    def _fitted(self, image: Frame) -> tuple[ImageResult, str | None]:
        """Depth of a frame, and why it is not fitted to known depth, if the video has any."""
        if not self.settings.anchors:
            return self._run(image, None), None
        number, names = self.clock.input_number(image), self.clock.name_numbers
        named = names[number] if names else number
        stamps = stamps_a_second(named) if names else None
        try:
            points = self.known.of_frame(
                named, image.timestamp_s or 0.0, float(self.clock.rate), stamps
            )
            if points is not None:
                return self._run(image, points), None
            advice = "{anchors_within} takes that of the nearest time"
            problem: str = Message(f"frame {number} has no known depth", advice)
        except InputError as error:
            problem = about(f"frame {number}", error.message)
        if self.job.pipeline.card.output.kind is not DepthKind.METRIC:
            raise InputError(problem, "give some for every frame, or another {model}")
        return self._run(image, None), problem

    def _run(self, image: Frame, points: KnownDepth | None) -> ImageResult:
        return self.job.run(ImageTask(image, self.settings.camera, points))


@dataclass(slots=True)
class VideoReport:
    """What is known of the frames so far."""

    raw: temporal.FlickerMeter  #: of the depth before smoothing
    smoothed: temporal.FlickerMeter  #: of that after it
    first: tuple[Frame, DepthMap] | None = None  #: the first frame, without pixels, and its depth
    warnings: tuple[str, ...] = ()  #: about the depth of the first frame
    unfitted: list[str] = field(default_factory=list)  #: why frames are not fitted
    scenes: int = 0
    times_s: array[float] = field(default_factory=lambda: array("d"))
    numbers: array[int] = field(default_factory=lambda: array("q"))

    def begin(self, frame: DepthFrame, warnings: Iterable[str]) -> None:
        """Note the first frame, with depth as it is written."""
        displayed = frame.displayed()
        self.first = (replace(displayed.image, pixels=np.zeros((1, 1), np.uint8)), displayed.depth)
        self.warnings = tuple(about(f"frame {frame.image.index}", text) for text in warnings)


class FrameFilter:
    """Smooths frames and the preview's range over time, and reports on them; in one thread.

    Attributes:
        report: of the frames that have passed.
    """

    def __init__(self, settings: VideoSettings, kind: DepthKind) -> None:
        """Begin before the first frame."""
        self._settings = settings
        self._changes, self._lock = temporal.ChangeDetector(), temporal.RangeLock()
        self._deflicker = temporal.Deflicker(settings.look_ahead)
        self._smoother = temporal.Smoother()
        self.report = VideoReport(temporal.FlickerMeter(kind), temporal.FlickerMeter(kind))

    def smooth(self, frames: Iterable[PredictedFrame]) -> Iterator[DepthFrame]:
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
    ) -> DepthFrame:
        """A frame with smoothed depth and colour range, and its share of the report."""
        report, now_s = self.report, frame.shown.time_s
        interval_s = now_s - report.times_s[-1] if report.times_s else 0.0
        report.times_s.append(now_s)
        report.numbers.append(frame.shown.image.index)
        if frame.unfitted:
            report.unfitted.append(frame.unfitted)
        if report.first is None:
            report.begin(restored(frame.shown, self._settings), frame.warnings)
        report.scenes += change.is_cut
        decay = temporal.ema_decay(interval_s, self._settings.lock_s)
        spread = self._lock.step(*frame.shown.spread, decay, is_cut=change.is_cut)
        report.raw.step(frame.sampled, change)
        depth = frame.shown.depth
        if correction is not None:
            decay = temporal.ema_decay(interval_s, self._settings.smooth_s)
            steps = self._smoother.step(depth.values, change, correction, decay)
            report.smoothed.step(temporal.sample_cells(steps, frame.thumbnail.shape), change)
            depth = replace(depth, values=steps)
        return replace(frame.shown, depth=depth, spread=spread)


def restored(frame: DepthFrame, settings: VideoSettings) -> DepthFrame:
    """Convert the smoother's output back to depth; thread-safe."""
    if not settings.smooth_s:
        return frame
    depth = frame.depth
    values = temporal.from_log(depth.values, depth.kind)
    return replace(frame, depth=replace(depth, values=values))


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
    depth = types.masked_to_data_window(replace(depth, values=values), windows)
    return depth, windows.only(windows.display, depth.values)
