"""A video's frames: each through the network alone, then over time in their order."""

from __future__ import annotations

import dataclasses
from array import array
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from depthcli.core.picture_limit import PictureLimit
from depthcli.core.temporal import changes as temporal
from depthcli.core.temporal.range_lock import RangeLock
from depthcli.core.temporal.smoothing import (
    FlickerMeter,
    Smoother,
    from_steps,
    kept_share,
    sample,
    to_steps,
)
from depthcli.core.types import DepthMap
from depthcli.io.pictures.decode import MAX_PIXELS
from depthcli.io.video.output import VideoFrame
from depthcli.io.video.spans import WHOLE, Span
from depthcli.io.writers.preview import percentiles

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from fractions import Fraction

    import numpy.typing as npt

    from depthcli.core.types import Frame
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.writers.options import WriterOptions

LOCK_S = 1.0
_LIMIT = PictureLimit(MAX_PIXELS)


class VideoSettings(NamedTuple):
    """Options of a run, the same for every video.

    Attributes:
        looks: options of the formats.
        workers: threads beside the one that decodes and writes.
        span: which frames.
        smooth_s: time constant of the depth's smoothing in seconds; 0 for none.
        lock_s: time constant of the preview's range; 0 for each frame's own.
        focal_px: focal length in pixels of a frame.
        hfov_deg: horizontal field of view in degrees.
        limit: videos with larger frames are refused.
        fps: frames a second of an image sequence; None for what it states.
        start_number: of the first frame in names of files; None for its number in the input.
    """

    looks: WriterOptions
    workers: int
    span: Span = WHOLE
    smooth_s: float = 0.0
    lock_s: float = LOCK_S
    focal_px: float | None = None
    hfov_deg: float | None = None
    limit: PictureLimit = _LIMIT
    fps: Fraction | None = None
    start_number: int | None = None


class Seen(NamedTuple):
    """A frame after the network, before anything that needs the frames around it.

    Attributes:
        frame: the picture.
        depth: its depth.
        guide: its brightness at a small size, (h, w) float32.
        steps: depth for smoothing, (H, W) float32 of ``to_steps``; None without smoothing.
        sampled: depth for the flicker figure, (h, w) float32 of ``to_steps``.
        spread: the percentiles of its depth.
        is_kept: whether an earlier run wrote it.
    """

    frame: Frame
    depth: DepthMap
    guide: npt.NDArray[np.float32]
    steps: npt.NDArray[np.float32] | None
    sampled: npt.NDArray[np.float32]
    spread: tuple[float, float]
    is_kept: bool = False


class Reel:
    """The state of a run between frames."""

    def __init__(
        self,
        pipeline: Pipeline,
        settings: VideoSettings,
        kept: Callable[[int], DepthMap | None] = lambda _number: None,
    ) -> None:
        """Begin.

        Args:
            pipeline: the model.
            settings: options.
            kept: depth of a frame that an earlier run wrote, by its number.
        """
        self._kept = kept
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

    def see(self, frame: Frame) -> Seen:
        """The network and all that looks at one frame alone; for any thread."""
        settings = self._settings
        # The first frame is always predicted, for what the report says of the model.
        kept = self._kept(frame.index) if self.first else None
        depth = kept or self._pipeline.predict(
            frame, focal_px=settings.focal_px, hfov_deg=settings.hfov_deg
        )
        guide = temporal.guide(frame.pixels)
        small = DepthMap(sample(depth.values, guide.shape), depth.kind)
        steps = to_steps(depth) if settings.smooth_s else None
        spread, is_kept = percentiles(small), kept is not None
        return Seen(frame, depth, guide, steps, to_steps(small), spread, is_kept)

    def steady(self, frames: Iterable[Seen]) -> Iterator[VideoFrame]:
        """The part that needs the frames in order; cheap, for one thread."""
        for seen in frames:
            now_s = seen.frame.timestamp_s or 0.0
            interval_s = now_s - self.times_s[-1] if self.times_s else 0.0
            self.times_s.append(now_s)
            self.numbers.append(seen.frame.index or 0)
            if self.first is None:
                alone = dataclasses.replace(seen.frame, pixels=np.zeros((1, 1), np.uint8))
                self.first = (alone, seen.depth)
            yield self._steadied(seen, interval_s)

    def _steadied(self, seen: Seen, interval_s: float) -> VideoFrame:
        change = self._changes.step(seen.guide)
        self.scenes += change.is_cut
        kept = kept_share(interval_s, self._settings.lock_s)
        spread = self._lock.step(*seen.spread, kept, is_cut=change.is_cut)
        self.raw.step(seen.sampled, change)
        depth = seen.depth
        if seen.steps is not None:
            kept = kept_share(interval_s, self._settings.smooth_s)
            steps = self._smoother.step(seen.steps, change, kept)
            self.smoothed.step(sample(steps, seen.guide.shape), change)
            depth = dataclasses.replace(depth, values=steps)
        return VideoFrame(seen.frame, depth, spread, seen.is_kept)

    def depth_of(self, shot: VideoFrame) -> VideoFrame:
        """Depth from what the smoother left; for any thread."""
        if not self._settings.smooth_s:
            return shot
        depth = shot.depth
        values = from_steps(depth.values, depth.kind)
        return dataclasses.replace(shot, depth=dataclasses.replace(depth, values=values))
