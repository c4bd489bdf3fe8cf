"""Going on where an earlier run was stopped, with what it left of depth."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
import numpy.typing as npt

from depthcli._version import __version__
from depthcli.core.fingerprint import fingerprint
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError, OutputError
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.read import read_depth
from depthcli.io.depth.steps import metres
from depthcli.io.storage.remote import RemotePath
from depthcli.jobs.video.plan import VideoPlan
from depthcli.jobs.video.request import VideoSettings
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.frame_journal import FrameJournal
from depthcli.video.frames import FrameSource
from depthcli.video.number_pattern import number_name, without_number
from depthcli.video.partial import PartialVideo, held_steps, partial_video

_BEST_FIRST = (VideoFormat.NPY, VideoFormat.EXR, VideoFormat.PNG16)


class EarlierFrames:
    """Depth that an earlier run wrote, and a place to note what this one does.

    That is read from numbered files, or else from a depth video that was not finished. All other
    outputs are made of it once more, so that they need no place to go on from.
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
        self._steps = iter(()) if partial is None else held_steps(partial.earlier)
        self._waiting = dict[int, npt.NDArray[np.uint16]]()
        #: where this run writes its depth video until it is whole; None for its own name
        self.written = None if partial is None else partial.written

    def follow(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """The frames, while the unfinished video is read beside them."""
        for frame in frames:
            steps = next(self._steps, None)
            if steps is not None:
                self._waiting[frame.index] = steps
            yield frame

    def kept(self, number: int) -> DepthMap | None:
        """Depth of a frame that is there; None if it is to be done. For any thread."""
        steps = self._waiting.pop(number, None)
        if steps is not None:
            return DepthMap(metres(steps, self._scale), self._kind)
        if self._journal is None or number not in self._journal.earlier:
            return None
        names = [number_name(self._plan.names[which], number) for which in self._formats]
        try:
            maps = [read_depth(self._plan.folder / name) for name in names]
        except InputError:
            return None
        return DepthMap(maps[0].values, self._kind)  # NPY does not say it

    def add(self, number: int) -> None:
        """Note that a frame is written."""
        if self._journal is not None:
            self._journal.add(number)


def rounding(plan: VideoPlan, pipeline: Pipeline, settings: VideoSettings) -> float | None:
    """Steps a metre to which depth is rounded before anything is made of it; None if it is not.

    It is where the outputs keep it in no other way, so that previews and figures follow from what
    they keep, and are the same whether or not a run was stopped in between.
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
    """What is done of a video already, and a place to note more.

    Nothing is taken over where frames follow from those before them, of a pipe or into one, and
    where the other outputs could not be made of what is kept.

    Raises:
        OutputError: the folder cannot be written to.
    """
    kept = plan, pipeline.card.output.kind, settings.writing.png_scale
    numbered = [which for which in plan.names if which in SEQUENCES]
    others = set(plan.names) - set(SEQUENCES)
    is_whole = (
        rounding(plan, pipeline, settings) is not None
        or VideoFormat.NPY in numbered
        or (VideoFormat.EXR in numbered and not settings.writing.half)
    )
    is_remote = isinstance(plan.folder, RemotePath)  # where nothing is appended to
    is_piped = not source.paths or plan.stdout is not None
    if settings.smooth_s or is_remote or is_piped or (others and not is_whole):
        yield EarlierFrames(*kept)
        return
    origin = _origin(plan, source, pipeline, settings)
    with ExitStack() as stack:
        try:
            if numbered:
                name = without_number(plan.names[numbered[0]])
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


def _origin(
    plan: VideoPlan, source: FrameSource, pipeline: Pipeline, settings: VideoSettings
) -> str:
    """Checksum of all that frames follow from."""
    states = [(path, path.stat()) for path in source.paths]
    card = pipeline.card
    return fingerprint(
        __version__,
        [(path, state.st_size, state.st_mtime_ns) for path, state in states],
        plan.names,
        pipeline.session.model.sha256,
        pipeline.session.provider,
        (card.input, card.output, card.camera),
        pipeline.detail,
        (settings.writing, settings.camera, settings.span, settings.fps, settings.start_number),
    )
