"""Going on with numbered files where an earlier run was stopped."""

from __future__ import annotations

import hashlib
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli._version import __version__
from depthcli.errors import InputError, OutputError
from depthcli.io.depth.read import read_depth
from depthcli.io.video.formats import SEQUENCES, VideoFormat
from depthcli.io.video.frame_journal import FrameJournal
from depthcli.io.video.frame_source import files_of
from depthcli.io.video.number_pattern import number_name, without_number

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from depthcli.core.types import DepthMap
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.video.sequence import ImageSequence
    from depthcli.io.video.source import VideoSource
    from depthcli.jobs.video.plan import VideoJob
    from depthcli.jobs.video.stages import VideoSettings

_BEST_FIRST = (VideoFormat.EXR, VideoFormat.NPY, VideoFormat.PNG16)


class Progress:
    """Frames that an earlier run wrote, and those of this one.

    With a video file among the outputs, or smoothing over time, a frame follows from all before it,
    so that nothing of an earlier run is taken over.
    """

    def __init__(self, job: VideoJob, journal: FrameJournal | None) -> None:
        self._job = job
        self._journal = journal
        self._formats = [which for which in _BEST_FIRST if which in job.names]

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
        return self._job.folder / number_name(self._job.names[which], number)


@contextmanager
def progress_of(
    job: VideoJob,
    source: VideoSource | ImageSequence,
    pipeline: Pipeline,
    settings: VideoSettings,
) -> Iterator[Progress]:
    """What is done of a job already, and a place to note more.

    Raises:
        OutputError: the folder cannot be written to.
    """
    if set(job.names) - {*SEQUENCES, VideoFormat.JSON} or settings.smooth_s:
        yield Progress(job, None)
        return
    name = without_number(next(job.names[which] for which in SEQUENCES if which in job.names))
    try:
        journal = FrameJournal(job.folder, name, _fingerprint(job, source, pipeline, settings))
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(
            f"cannot write into {job.folder}: {reason}; choose another --out"
        ) from error
    with journal:
        yield Progress(job, journal)


def _fingerprint(
    job: VideoJob,
    source: VideoSource | ImageSequence,
    pipeline: Pipeline,
    settings: VideoSettings,
) -> str:
    """Checksum of all that frames follow from."""
    states = [(str(path), path.stat()) for path in files_of(source)]
    card = pipeline.card
    decisive = (
        __version__,
        [(name, state.st_size, state.st_mtime_ns) for name, state in states],
        sorted(job.names.items()),
        pipeline.session.model.sha256,
        pipeline.session.provider,
        (card.input, card.output, card.camera),
        pipeline.detail,
        settings._replace(workers=0),
    )
    return hashlib.sha256(repr(decisive).encode("utf-8", "surrogateescape")).hexdigest()
