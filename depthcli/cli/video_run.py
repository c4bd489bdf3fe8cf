"""What ``depthcli video`` does: frames through the model, over time, and into their files."""

from __future__ import annotations

import dataclasses
import time
from array import array
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from depthcli.cli.video_choices import VideoFormat
from depthcli.cli.video_report import VideoDone
from depthcli.core import temporal
from depthcli.core.opencv_threads import one_thread_each
from depthcli.core.ordered_map import ordered_map
from depthcli.core.temporal_depth import (
    FlickerMeter,
    Smoother,
    from_steps,
    kept_share,
    sample,
    to_steps,
)
from depthcli.core.temporal_range import RangeLock
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError
from depthcli.io.atomic import atomic_path
from depthcli.io.decode import MAX_PIXELS
from depthcli.io.sources.video import VideoSource
from depthcli.io.sources.video_span import WHOLE, Span
from depthcli.io.writers.preview import percentiles
from depthcli.io.writers.video import Shot

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import numpy.typing as npt

    from depthcli.cli.looks import Looks
    from depthcli.cli.video_outputs import VideoJob
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.writers.video import VideoOutput

LOCK_S = 1.0
_ON_GRID = 1e-6


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
        max_pixels: videos with larger frames are refused.
    """

    looks: Looks
    workers: int
    span: Span = WHOLE
    smooth_s: float = 0.0
    lock_s: float = LOCK_S
    focal_px: float | None = None
    hfov_deg: float | None = None
    max_pixels: int = MAX_PIXELS


class Seen(NamedTuple):
    """A frame after the network, before anything that needs the frames around it.

    Attributes:
        frame: the picture.
        depth: its depth.
        guide: its brightness at a small size, (h, w) float32.
        steps: depth for smoothing, (H, W) float32 of ``to_steps``; None without smoothing.
        sampled: depth for the flicker figure, (h, w) float32 of ``to_steps``.
        spread: the percentiles of its depth.
    """

    frame: Frame
    depth: DepthMap
    guide: npt.NDArray[np.float32]
    steps: npt.NDArray[np.float32] | None
    sampled: npt.NDArray[np.float32]
    spread: tuple[float, float]


class Reel:
    """The state of a run between frames."""

    def __init__(self, pipeline: Pipeline, settings: VideoSettings) -> None:
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

    def see(self, frame: Frame) -> Seen:
        """The network and all that looks at one frame alone; for any thread."""
        settings = self._settings
        depth = self._pipeline.predict(
            frame, focal_px=settings.focal_px, hfov_deg=settings.hfov_deg
        )
        guide = temporal.guide(frame.pixels)
        small = DepthMap(sample(depth.values, guide.shape), depth.kind)
        steps = to_steps(depth) if settings.smooth_s else None
        return Seen(frame, depth, guide, steps, to_steps(small), percentiles(small))

    def steady(self, frames: Iterable[Seen]) -> Iterator[Shot]:
        """The part that needs the frames in order; cheap, for one thread."""
        for seen in frames:
            now_s = seen.frame.timestamp_s or 0.0
            interval_s = now_s - self.times_s[-1] if self.times_s else 0.0
            self.times_s.append(now_s)
            if self.first is None:
                alone = dataclasses.replace(seen.frame, pixels=np.zeros((1, 1), np.uint8))
                self.first = (alone, seen.depth)
            yield self._steadied(seen, interval_s)

    def _steadied(self, seen: Seen, interval_s: float) -> Shot:
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
        return Shot(seen.frame, depth, spread)

    def depth_of(self, shot: Shot) -> Shot:
        """Depth from what the smoother left; for any thread."""
        if not self._settings.smooth_s:
            return shot
        depth = shot.depth
        values = from_steps(depth.values, depth.kind)
        return shot._replace(depth=dataclasses.replace(depth, values=values))


def run_video(
    job: VideoJob,
    pipeline: Pipeline,
    settings: VideoSettings,
    watch: Callable[[int, int | None], None] = lambda _done, _total: None,
) -> VideoDone:
    """Depth of a video, in memory that does not grow with it.

    Args:
        job: the video and its outputs.
        pipeline: the model; its session should have one thread where there are several workers.
        settings: options.
        watch: called after each frame with how many are done, and how many there will be if the
            file says so.

    Returns:
        What was written. Its ``problem`` is set if the video ended early; what there was is
        written.

    Raises:
        InputError: the video cannot be read, or has no frame in the span.
        OutputError: an output cannot be written; nothing is left.
        ModelError: the network failed; nothing is left.
        UsageError: the options do not fit the model.
    """
    start = time.perf_counter()
    with VideoSource(job.source, max_pixels=settings.max_pixels) as source, ExitStack() as stack:
        rate = settings.span.rate(source.rate)
        videos = [which for which in job.names if which is not VideoFormat.JSON]
        outputs = [
            stack.enter_context(job.open(which, settings.looks, rate, pipeline.card))
            for which in videos
        ]
        sidecar = (
            stack.enter_context(atomic_path(job.path(VideoFormat.JSON), inputs=(job.source,)))
            if VideoFormat.JSON in job.names
            else None
        )
        reel = Reel(pipeline, settings)
        _through(source, reel, outputs, settings, watch)
        if reel.first is None:
            raise InputError(_nothing(job, source))
        times_s = [time_s - reel.times_s[0] for time_s in reel.times_s]
        warnings = [*source.warnings, *pipeline.session.warnings]
        for output in outputs:
            warnings += output.finish(times_s)
        is_regular = all(abs(t * rate - i) < _ON_GRID for i, t in enumerate(times_s))
        smooths = settings.smooth_s > 0
        done = VideoDone(
            name=job.name,
            outputs=tuple(str(job.path(which)) for which in job.names),
            frames=len(times_s),
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
            scale=settings.looks.png_scale,
            provider=pipeline.session.provider,
            seconds=time.perf_counter() - start,
            warnings=tuple(warnings),
            problem=source.problem,
        )
        if sidecar is not None:
            sidecar.write_text(done.sidecar(), "utf-8")
    return done._replace(seconds=time.perf_counter() - start)


def _through(
    source: VideoSource,
    reel: Reel,
    outputs: Sequence[VideoOutput],
    settings: VideoSettings,
    watch: Callable[[int, int | None], None],
) -> None:
    """Every frame through all stages, each stage a few frames ahead of the next."""

    def encoded(shot: Shot) -> list[Any]:
        whole = reel.depth_of(shot)
        return [output.encode(whole) for output in outputs]

    total = None
    if source.frames_stated is not None:
        total = settings.span.count(source.frames_stated, source.rate)
    workers = settings.workers
    # Closed before the outputs are: no thread may write into what is being removed.
    with (
        one_thread_each(workers),
        closing(ordered_map(reel.see, source.frames(settings.span), workers=workers)) as seen,
        closing(ordered_map(encoded, reel.steady(seen), workers=workers)) as parts,
    ):
        for done, part in enumerate(parts, start=1):
            for output, one in zip(outputs, part, strict=True):
                output.append(one)
            watch(done, total)


def _nothing(job: VideoJob, source: VideoSource) -> str:
    if source.problem:
        return f"{job.name} has no frame that can be read: {source.problem}"
    stated = source.frames_stated
    length = (
        "" if stated is None else f"; it has {stated} frames, {float(stated / source.rate):.3f} s"
    )
    return f"{job.name} has no frame between --start and --end{length}"
