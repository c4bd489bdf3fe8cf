"""Processing the frames of a planned video, and writing its outputs."""

import dataclasses
import hashlib
import json
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from depthcli.core.parallel import one_thread_each, ordered_map, share_cores
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, OutputError
from depthcli.inference.camera import focal_warnings
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.metadata import SOFTWARE, DepthMetadata
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.sidecar import remove_video_sidecar
from depthcli.io.formats.table import WriterOptions
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.guard import Guard
from depthcli.io.storage.paths import RemotePath
from depthcli.io.storage.transfer import local_copy
from depthcli.jobs.outputs import output_guard
from depthcli.jobs.video.plan import VideoPlan, VideoRequest, VideoSettings, plan_video
from depthcli.jobs.video.resume import earlier_frames, rounding_scale
from depthcli.jobs.video.stages import FrameStages
from depthcli.video.audio import AudioTrack
from depthcli.video.formats import SEQUENCES, VIDEO_FORMATS, VideoFormat, preview_codec
from depthcli.video.frames import FrameSource, Timing, rate_text
from depthcli.video.numbering import base_name, numbered_name
from depthcli.video.outputs import (
    DepthFrame,
    SequenceOutput,
    VideoOutput,
    depth_video,
    preview_video,
)
from depthcli.video.source import is_sequence, open_frames
from depthcli.video.time_code import time_code_text


def open_output(
    which: VideoFormat,
    plan: VideoPlan,
    writing: WriterOptions,
    source: FrameSource,
    rate: Fraction,
    guard: Guard,
) -> AbstractContextManager[VideoOutput]:
    """Open the output of one format.

    Args:
        which: the format; not JSON, which is written after all others.
        plan: the paths of the outputs.
        writing: options of the formats.
        source: the video or sequence that is read.
        rate: frames per second of the output.
        guard: of existing files.
    """
    target = plan.target(which)
    step = source.rate / rate
    is_stepped = not source.numbers_follow_times and step.denominator == 1
    timing = Timing(rate, source.tick_s, source.rate, step.numerator if is_stepped else None)
    if which is VideoFormat.MKV:
        colours = PreviewWriter(vmin=writing.vmin, vmax=writing.vmax)
        return depth_video(target, timing, writing.png_scale, guard, colours)
    picture = VIDEO_FORMATS[which].picture
    if picture is None:
        raise ValueError(which)
    writer = writing.writer(picture)
    if not isinstance(writer, PreviewWriter):
        name = partial(numbered_name, plan.names[which])
        has_overscan = picture.facts.has_overscan
        return nullcontext(
            SequenceOutput(which.value, plan.folder, name, writer, guard, has_overscan=has_overscan)
        )
    codec = plan.codecs.get(which) or preview_codec(target.suffix.lower(), None)
    audio = None
    if plan.has_audio and source.start_s is not None:
        audio = AudioTrack(plan.source, source.start_s)
    return preview_video(target, timing, writer, guard, codec=codec, audio=audio)


@dataclass(frozen=True, slots=True)
class VideoResult:
    """The result of a video whose outputs are all written."""

    name: str  #: the video, as the user wrote it
    #: the files written; a sequence's with ``%06d`` for the frame's number
    outputs: tuple[str, ...]
    numbers: Sequence[int]  #: numbers of the frames written; the first of the file has 0
    times_s: Sequence[float]  #: time of each of them, from the first frame of the video
    rate: Fraction  #: frames per second of the outputs, exact
    source_rate: Fraction  #: frames per second of the video
    is_regular: bool  #: whether the frame rate is constant
    first: Frame  #: first frame written, without its pixels
    depth: DepthMap  #: its depth, for kind and model
    #: flicker of the depth written, see ``FlickerMeter``; None without two similar frames
    flicker: float | None
    flicker_unsmoothed: float | None  #: flicker before smoothing; None without smoothing
    scenes: int  #: number of scenes
    smooth_s: float  #: time constant of the smoothing
    lock_s: float  #: time constant of the preview's range
    scale: float | None  #: units per metre in 16-bit outputs; None if each is normalized
    provider: str  #: the provider that ran the model
    seconds: float  #: from opening the video to the last output
    warnings: tuple[str, ...]  #: one line each
    problem: str | None  #: why frames are missing at the end; None if none are

    @property
    def frames(self) -> int:
        """Number of frames written."""
        return len(self.numbers)

    def metadata(self) -> dict[str, object]:
        """The fields of JSON and sidecar that are the same for every run."""
        depth, known = self.depth, DepthMetadata.of(self.depth)
        time_code = self.first.time_code
        return {
            "frames": self.frames,
            "fps": rate_text(self.rate),
            "source_fps": rate_text(self.source_rate),
            "constant_rate": self.is_regular,
            "first_frame": self.first.index,
            "start_s": self.first.timestamp_s,
            "time_code": None if time_code is None else time_code_text(time_code, self.source_rate),
            "width": depth.width,
            "height": depth.height,
            "orientation": self.first.orientation,
            "kind": known.kind,
            "unit": known.unit,
            "scale": self.scale if depth.is_metric else None,
            "scenes": self.scenes,
            "flicker": self.flicker,
            "flicker_unsmoothed": self.flicker_unsmoothed,
            "smooth_s": self.smooth_s,
            "lock_s": self.lock_s,
            **known.origin(),
        }

    def sidecar(self, *, has_times: bool) -> str:
        """The text of the sidecar, the same for every run.

        With ``has_times``, it also states the time of each frame by its number, for numbered files.
        """
        metadata = {"software": SOFTWARE, **self.metadata()}
        if has_times:
            metadata["times_s"] = dict(zip(self.numbers, self.times_s, strict=True))
        return json.dumps(metadata, indent=2, allow_nan=False) + "\n"


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
                if count == 0 and sidecar is None:
                    _remove_stale_sidecars(plan)
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


def _remove_stale_sidecars(plan: VideoPlan) -> None:
    """Remove the sidecar of an earlier run, which would state its camera for files without one."""
    for which, name in plan.names.items():
        picture = VIDEO_FORMATS[which].picture
        if which in SEQUENCES and picture is not None and not picture.facts.has_camera:
            remove_video_sidecar(plan.folder / f"{base_name(name)}.json")


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


def video(request: VideoRequest, progress: Progress = NO_PROGRESS) -> VideoResult:
    """Predict the depth of a video, in constant memory.

    After an error, incomplete video files are removed; complete numbered files are kept, and are
    reused if the same request is made again.

    Args:
        request: the video and its outputs.
        progress: advanced for each frame; its total is the number of frames, if the file states it.

    Returns:
        What was written. ``problem`` is set if the video ended early; its frames up to there are
        written.

    Raises:
        InputError: the video cannot be read, or has no frame in the span.
        OutputError: an output cannot be written.
        ModelError: the model cannot be used.
        UsageError: the outputs do not fit the video, or collide, or an option does not fit the
            model.
    """
    plan = plan_video(request)
    workers, threads = share_cores(request.workers, request.model.threads)
    loading = replace(request.model, threads=threads).start()
    # Imported here, while the model loads.
    from depthcli.inference.pipeline import Pipeline  # noqa: PLC0415

    pipeline = Pipeline(loading.result(), request.settings.detail)
    with _local_plan(plan, progress) as here:
        return write_video(here, pipeline, request.settings, workers, progress)


@contextmanager
def _local_plan(plan: VideoPlan, progress: Progress) -> Iterator[VideoPlan]:
    """The plan with a local copy of a video in a store, as FFmpeg's libraries open local files."""
    if not isinstance(plan.source, RemotePath) or is_sequence(plan.source):
        yield plan
        return
    with local_copy(plan.source, progress) as copy:
        with copy.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        yield replace(plan, source=copy, sha256=sha256)
