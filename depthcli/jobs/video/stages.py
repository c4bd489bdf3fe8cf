"""The processing stages of a video's frames: prediction per frame, then filtering over time."""

import dataclasses
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from depthcli.core import temporal
from depthcli.core.temporal import (
    FlickerMeter,
    RangeLock,
    Smoother,
    ema_decay,
    from_log,
    sample_cells,
    to_log,
)
from depthcli.core.types import DepthMap, Frame, Windows, masked_to_data_window, over_window
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.scale import dequantized, quantized
from depthcli.io.formats.preview import percentiles
from depthcli.jobs.video.plan import VideoSettings
from depthcli.video.outputs import DepthFrame


@dataclass(frozen=True, slots=True)
class PredictedFrame:
    """A frame after prediction, before the stages that depend on other frames."""

    picture: Frame  #: the frame of the video
    depth: DepthMap  #: its depth
    thumbnail: npt.NDArray[np.float32]  #: its brightness at a reduced size, (h, w) float32
    #: depth for smoothing, (H, W) float32 of ``to_log``; None without smoothing
    steps: npt.NDArray[np.float32] | None
    #: depth for the flicker figure, (h, w) float32 of ``to_log``
    sampled: npt.NDArray[np.float32]
    spread: tuple[float, float]  #: percentiles of its depth
    is_kept: bool = False  #: whether an earlier run wrote it


class FrameStages:
    """The stages of each frame, and the state between frames."""

    def __init__(
        self,
        pipeline: Pipeline,
        settings: VideoSettings,
        kept: Callable[[int], DepthMap | None] = lambda _number: None,
        scale: float | None = None,
    ) -> None:
        """Initialize the state.

        Args:
            pipeline: the model.
            settings: options.
            kept: returns the depth of a frame number if an earlier run wrote it, else None.
            scale: units per metre to which depth is rounded; None for no rounding.
        """
        self._kept, self._scale = kept, scale
        self._pipeline = pipeline
        self._settings = settings
        self._changes = temporal.ChangeDetector()
        self._lock = RangeLock()
        self._smoother = Smoother()
        kind = pipeline.card.output.kind
        self.raw, self.smoothed = FlickerMeter(kind), FlickerMeter(kind)
        self.scenes = 0
        self.first: tuple[Frame, DepthMap] | None = None
        self.times_s = array("d")
        self.numbers = array("q")

    def predict(self, picture: Frame) -> PredictedFrame:
        """Predict a frame, and all that depends on one frame only; thread-safe."""
        camera = self._settings.camera
        picture = picture.with_pixel_aspect(camera.pixel_aspect or picture.pixel_aspect)
        kept = self._kept(picture.index)
        if self.first is None:
            kept = None  # the first frame is always predicted, for the report
        depth = kept or self._pipeline.predict(picture, camera).depth
        if self._scale is not None and kept is None:
            values = dequantized(quantized(depth.values, self._scale)[0], self._scale)
            depth = dataclasses.replace(depth, values=values)
        depth, shown = _in_windows(depth, picture.windows, is_kept=kept is not None)
        thumbnail = temporal.thumbnail(picture.pixels)
        small = DepthMap(sample_cells(shown, thumbnail.shape), depth.kind)
        steps = to_log(depth) if self._settings.smooth_s else None
        spread, is_kept = percentiles(small), kept is not None
        return PredictedFrame(picture, depth, thumbnail, steps, to_log(small), spread, is_kept)

    def smooth(self, frames: Iterable[PredictedFrame]) -> Iterator[DepthFrame]:
        """The stages that need the frames in order; fast, in one thread."""
        for frame in frames:
            now_s = frame.picture.timestamp_s or 0.0
            interval_s = now_s - self.times_s[-1] if self.times_s else 0.0
            self.times_s.append(now_s)
            self.numbers.append(frame.picture.index)
            if self.first is None:
                shown = DepthFrame(frame.picture, frame.depth, frame.spread).displayed()
                alone = dataclasses.replace(shown.picture, pixels=np.zeros((1, 1), np.uint8))
                self.first = (alone, shown.depth)
            yield self._smoothed(frame, interval_s)

    def _smoothed(self, frame: PredictedFrame, interval_s: float) -> DepthFrame:
        change = self._changes.step(frame.thumbnail)
        self.scenes += change.is_cut
        decay = ema_decay(interval_s, self._settings.lock_s)
        spread = self._lock.step(*frame.spread, decay, is_cut=change.is_cut)
        self.raw.step(frame.sampled, change)
        depth = frame.depth
        if frame.steps is not None:
            decay = ema_decay(interval_s, self._settings.smooth_s)
            steps = self._smoother.step(frame.steps, change, decay)
            self.smoothed.step(sample_cells(steps, frame.thumbnail.shape), change)
            depth = dataclasses.replace(depth, values=steps)
        return DepthFrame(frame.picture, depth, spread, frame.is_kept)

    def restore(self, frame: DepthFrame) -> DepthFrame:
        """Convert the smoother's output back to depth; thread-safe."""
        if not self._settings.smooth_s:
            return frame
        depth = frame.depth
        values = from_log(depth.values, depth.kind)
        return dataclasses.replace(frame, depth=dataclasses.replace(depth, values=values))


def _in_windows(
    depth: DepthMap, windows: Windows | None, *, is_kept: bool
) -> tuple[DepthMap, npt.NDArray[np.float32]]:
    """Depth over all pixels of its frame, without any where the file has no pixels.

    Args:
        depth: of all pixels; of the display window alone if an earlier run wrote it.
        windows: of the frame.
        is_kept: whether an earlier run wrote it.

    Returns:
        The map, and its values without overscan, (H, W) float32 of the same size.
    """
    if windows is None:
        return depth, depth.values
    covered = windows.display if is_kept else windows.pixels
    values = over_window(depth.values, covered, windows.pixels)
    depth = masked_to_data_window(dataclasses.replace(depth, values=values), windows)
    return depth, windows.only(windows.display, depth.values)
