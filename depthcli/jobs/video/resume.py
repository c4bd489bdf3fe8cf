"""Resuming a video that was stopped, with the depth that the earlier run wrote."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import numpy.typing as npt

from depthcli._version import __version__
from depthcli.core.fingerprint import fingerprint
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError, OutputError
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.quantization import dequantized
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.storage.remote import RemotePath
from depthcli.jobs.video.plan import VideoPlan
from depthcli.jobs.video.request import VideoSettings
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.frame_journal import FrameJournal, remove_journal
from depthcli.video.frames import FrameSource
from depthcli.video.number_pattern import base_name, numbered_name
from depthcli.video.partial import (
    PartialVideo,
    partial_video,
    readable_steps,
    remove_partial_videos,
)

_BEST_FIRST = (VideoFormat.NPY, VideoFormat.EXR, VideoFormat.PNG16)


class EarlierFrames:
    """Depth that an earlier run wrote, and a record of the frames that this run writes.

    It is read from numbered files, or else from an unfinished depth video. All other outputs are
    written again from it.
    """

    def __init__(
        self,
        plan: VideoPlan,
        kind: DepthKind,
        scale: float,
        journal: FrameJournal | None = None,
        partial: PartialVideo | None = None,
    ) -> None:
        self._plan, self._kind, self._scale, self._journal = plan, kind, scale, journal
        self._formats = [which for which in _BEST_FIRST if which in plan.names]
        self._steps = iter(()) if partial is None else readable_steps(partial.earlier)
        self._waiting = dict[int, npt.NDArray[np.uint16]]()
        #: path of this run's depth video until it is complete; None for its final name
        self.written = None if partial is None else partial.written

    def follow(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Yield the frames, and read the unfinished video in parallel."""
        for frame in frames:
            steps = next(self._steps, None)
            if steps is not None:
                self._waiting[frame.index] = steps
            yield frame

    def kept(self, number: int) -> DepthMap | None:
        """Depth of a frame that the earlier run wrote, else None; thread-safe."""
        steps = self._waiting.pop(number, None)
        if steps is not None:
            return DepthMap(dequantized(steps, self._scale), self._kind)
        if self._journal is None or number not in self._journal.earlier:
            return None
        names = [numbered_name(self._plan.names[which], number) for which in self._formats]
        try:
            maps = [read_stored_depth(self._plan.folder / name).displayed for name in names]
        except InputError:
            return None
        return DepthMap(maps[0].values, self._kind)  # NPY does not state the kind

    def add(self, number: int) -> None:
        """Record that a frame is written."""
        if self._journal is not None:
            self._journal.add(number)


def rounding_scale(plan: VideoPlan, pipeline: Pipeline, settings: VideoSettings) -> float | None:
    """Units per metre to which depth is rounded before it is used; None for no rounding.

    Depth is rounded if all depth outputs are 16-bit, so that previews and figures are computed from
    the values that are written, and are the same whether or not the run was resumed.
    """
    writing = settings.writing
    is_in_steps = {VideoFormat.MKV, VideoFormat.PNG16} & set(plan.names)
    is_finer = {VideoFormat.EXR, VideoFormat.NPY} & set(plan.names)
    is_metric = pipeline.card.output.kind is DepthKind.METRIC
    if settings.smooth_s or writing.png_normalize or is_finer or not (is_in_steps and is_metric):
        return None
    return writing.png_scale


@contextmanager
def earlier_frames(
    plan: VideoPlan, source: FrameSource, pipeline: Pipeline, settings: VideoSettings
) -> Iterator[EarlierFrames]:
    """The frames of an earlier run, if it can be resumed.

    It cannot with smoothing, as frames then depend on previous ones; with pipes; in an object
    store; or if the other outputs cannot be made from the depth that is kept. The records of an
    earlier run are removed then, because this run replaces its frames.

    Raises:
        OutputError: the folder cannot be written to.
    """
    kept = plan, pipeline.card.output.kind, settings.writing.png_scale
    numbered = [which for which in plan.names if which in SEQUENCES]
    others = set(plan.names) - set(SEQUENCES)
    is_whole = (
        rounding_scale(plan, pipeline, settings) is not None
        or VideoFormat.NPY in numbered
        or (VideoFormat.EXR in numbered and not settings.writing.half)
    )
    if isinstance(plan.folder, RemotePath) or plan.stdout is not None:  # nothing is appended to
        yield EarlierFrames(*kept)
        return
    can_resume = not settings.smooth_s and bool(source.paths) and (is_whole or not others)
    origin = _origin(plan, source, pipeline, settings) if can_resume else None
    with ExitStack() as stack:
        try:
            if origin is None:
                _remove_records(plan)
                earlier = EarlierFrames(*kept)
            elif numbered:
                if VideoFormat.MKV in plan.names:
                    remove_partial_videos(plan.path(VideoFormat.MKV))
                name = base_name(plan.names[numbered[0]])
                journal = stack.enter_context(FrameJournal(plan.folder, name, origin))
                earlier = EarlierFrames(*kept, journal)
            else:
                mkv = plan.path(VideoFormat.MKV)
                partial = stack.enter_context(partial_video(mkv, origin))
                earlier = EarlierFrames(*kept, None, partial)
        except OSError as error:
            reason = error.strerror or str(error)
            where = error.filename or f"into {plan.folder}"
            raise OutputError(f"cannot write {where}: {reason}; choose another --out") from error
        yield earlier


def _remove_records(plan: VideoPlan) -> None:
    for which in plan.names:
        if which in SEQUENCES:
            remove_journal(plan.folder, base_name(plan.names[which]))
        elif which is VideoFormat.MKV:
            remove_partial_videos(plan.path(which))


def _origin(
    plan: VideoPlan, source: FrameSource, pipeline: Pipeline, settings: VideoSettings
) -> str:
    """Fingerprint of everything that the frames depend on."""
    states = [(path, path.stat()) for path in source.paths]
    card = pipeline.card
    return fingerprint(
        __version__,
        plan.sha256 or [(path, state.st_size, state.st_mtime_ns) for path, state in states],
        plan.names,
        pipeline.session.model.sha256,
        pipeline.session.provider,
        sorted(pipeline.session.provider_options.items()),
        (card.input, card.output, card.camera),
        pipeline.detail.without_limits(),
        (settings.writing, settings.camera, settings.span, settings.fps, settings.start_number),
    )
