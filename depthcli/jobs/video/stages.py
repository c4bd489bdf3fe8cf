"""A video's frames: each through the network alone, then over time in their order."""

import dataclasses
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from depthcli.core.temporal import changes as temporal
from depthcli.core.temporal.range_lock import RangeLock
from depthcli.core.temporal.smoothing import (
    FlickerMeter,
    Smoother,
    from_steps,
    kept_share,
    sample_cells,
    to_steps,
)
from depthcli.core.types import DepthMap, Frame
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.steps import metres, quantized
from depthcli.io.writers.preview import percentiles
from depthcli.jobs.video.request import VideoSettings
from depthcli.video.output import VideoFrame


@dataclass(frozen=True, slots=True)
class PredictedFrame:
    """A frame after the network, before anything that needs the frames around it."""

    picture: Frame  #: what is seen
    depth: DepthMap  #: its depth
    guide: npt.NDArray[np.float32]  #: its brightness at a small size, (h, w) float32
    #: depth for smoothing, (H, W) float32 of ``to_steps``; None without smoothing
    steps: npt.NDArray[np.float32] | None
    #: depth for the flicker figure, (h, w) float32 of ``to_steps``
    sampled: npt.NDArray[np.float32]
    spread: tuple[float, float]  #: the percentiles of its depth
    is_kept: bool = False  #: whether an earlier run wrote it


class FrameStages:
    """What happens to each frame, and the state between frames."""

    def __init__(
        self,
        pipeline: Pipeline,
        settings: VideoSettings,
        kept: Callable[[int], DepthMap | None] = lambda _number: None,
        scale: float | None = None,
    ) -> None:
        """Begin.

        Args:
            pipeline: the model.
            settings: options.
            kept: depth of a frame that an earlier run wrote, by its number.
            scale: steps a metre to which depth is rounded; None for depth as it is.
        """
        self._kept, self._scale = kept, scale
        self._pipeline = pipeline
        self._settings = settings
        self._changes = temporal.Changes()
        self._lock = RangeLock()
        self._smoother = Smoother()
        kind = pipeline.card.output.kind
        self.raw, self.smoothed = FlickerMeter(kind), FlickerMeter(kind)
        self.scenes = 0
        self.first: tuple[Frame, DepthMap] | None = None
        self.times_s = array("d")
        self.numbers = array("q")

    def predict(self, picture: Frame) -> PredictedFrame:
        """The network and all that looks at one frame alone; for any thread."""
        camera = self._settings.camera
        kept = self._kept(picture.index)
        if self.first is None:
            kept = None  # the first frame is always predicted, for what the report says of it
        depth = kept or self._pipeline.predict(
            picture, focal_px=camera.focal_px, hfov_deg=camera.hfov_deg
        )
        if self._scale is not None and kept is None:
            values = metres(quantized(depth.values, self._scale)[0], self._scale)
            depth = dataclasses.replace(depth, values=values)
        guide = temporal.guide(picture.pixels)
        small = DepthMap(sample_cells(depth.values, guide.shape), depth.kind)
        steps = to_steps(depth) if self._settings.smooth_s else None
        spread, is_kept = percentiles(small), kept is not None
        return PredictedFrame(picture, depth, guide, steps, to_steps(small), spread, is_kept)

    def smooth(self, frames: Iterable[PredictedFrame]) -> Iterator[VideoFrame]:
        """The part that needs the frames in order; cheap, for one thread."""
        for frame in frames:
            now_s = frame.picture.timestamp_s or 0.0
            interval_s = now_s - self.times_s[-1] if self.times_s else 0.0
            self.times_s.append(now_s)
            self.numbers.append(frame.picture.index)
            if self.first is None:
                alone = dataclasses.replace(frame.picture, pixels=np.zeros((1, 1), np.uint8))
                self.first = (alone, frame.depth)
            yield self._smoothed(frame, interval_s)

    def _smoothed(self, frame: PredictedFrame, interval_s: float) -> VideoFrame:
        change = self._changes.step(frame.guide)
        self.scenes += change.is_cut
        kept = kept_share(interval_s, self._settings.lock_s)
        spread = self._lock.step(*frame.spread, kept, is_cut=change.is_cut)
        self.raw.step(frame.sampled, change)
        depth = frame.depth
        if frame.steps is not None:
            kept = kept_share(interval_s, self._settings.smooth_s)
            steps = self._smoother.step(frame.steps, change, kept)
            self.smoothed.step(sample_cells(steps, frame.guide.shape), change)
            depth = dataclasses.replace(depth, values=steps)
        return VideoFrame(frame.picture, depth, spread, frame.is_kept)

    def restore(self, frame: VideoFrame) -> VideoFrame:
        """Depth from what the smoother left; for any thread."""
        if not self._settings.smooth_s:
            return frame
        depth = frame.depth
        values = from_steps(depth.values, depth.kind)
        return dataclasses.replace(frame, depth=dataclasses.replace(depth, values=values))
