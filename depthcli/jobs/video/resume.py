"""Going on with numbered files where an earlier run was stopped."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli._version import __version__
from depthcli.core.fingerprint import fingerprint
from depthcli.errors import InputError, OutputError
from depthcli.io.depth.read import read_depth
from depthcli.io.storage.remote import RemotePath
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.frame_journal import FrameJournal
from depthcli.video.number_pattern import number_name, without_number

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from depthcli.core.types import DepthMap
    from depthcli.inference.pipeline import Pipeline
    from depthcli.jobs.video.plan import VideoPlan
    from depthcli.jobs.video.settings import VideoSettings
    from depthcli.video.frames import FrameSource

_BEST_FIRST = (VideoFormat.EXR, VideoFormat.NPY, VideoFormat.PNG16)


class EarlierFrames:
    """Frames that an earlier run wrote, and those of this one.

    With a video file among the outputs, or smoothing over time, a frame follows from all before it,
    so that nothing of an earlier run is taken over.
    """

    def __init__(self, plan: VideoPlan, journal: FrameJournal | None) -> None:
        self._plan = plan
        self._journal = journal
        self._formats = [which for which in _BEST_FIRST if which in plan.names]

    def kept(self, number: int) -> DepthMap | None:
        """Depth of a frame whose files are all there; None if it is to be done."""
        if self._journal is None or number not in self._journal.earlier:
            return None
        try:
            maps = [read_depth(self._path(which, number)) for which in self._formats]
        except InputError:
            return None
        return maps[0]

    def add(self, number: int) -> None:
        """Note that a frame is written."""
        if self._journal is not None:
            self._journal.add(number)

    def _path(self, which: VideoFormat, number: int) -> Path:
        return self._plan.folder / number_name(self._plan.names[which], number)


@contextmanager
def earlier_frames(
    plan: VideoPlan,
    source: FrameSource,
    pipeline: Pipeline,
    settings: VideoSettings,
) -> Iterator[EarlierFrames]:
    """What is done of a video already, and a place to note more.

    Raises:
        OutputError: the folder cannot be written to.
    """
    is_all_numbered = not set(plan.names) - {*SEQUENCES, VideoFormat.JSON}
    is_remote = isinstance(plan.folder, RemotePath)  # where nothing is appended to
    if not (is_all_numbered and source.paths) or settings.smooth_s or is_remote:
        yield EarlierFrames(plan, None)
        return
    name = without_number(next(plan.names[which] for which in SEQUENCES if which in plan.names))
    try:
        journal = FrameJournal(plan.folder, name, _origin(plan, source, pipeline, settings))
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(
            f"cannot write into {plan.folder}: {reason}; choose another --out"
        ) from error
    with journal:
        yield EarlierFrames(plan, journal)


def _origin(
    plan: VideoPlan,
    source: FrameSource,
    pipeline: Pipeline,
    settings: VideoSettings,
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
