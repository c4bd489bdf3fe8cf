"""Resuming a video that was stopped, with the numbered files that the earlier run wrote."""

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Self

from depthcli._version import __version__
from depthcli.core.arrays import Float32Array
from depthcli.core.types import DepthKind
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, OutputError, os_errors_as
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.table import READABLE
from depthcli.io.storage.paths import RemotePath
from depthcli.jobs.video.plan import VideoPlan
from depthcli.known.frames import KnownDepthOfFrames
from depthcli.video.formats import SEQUENCES, VideoFormat
from depthcli.video.frames import FrameSource
from depthcli.video.numbering import base_name, numbered_name

_NORMALS = (VideoFormat.NORMALS, VideoFormat.NORMALS_EXR)
_NUMBER = re.compile(r"[0-9]{1,18}")


class FrameJournal:
    """A hidden file beside numbered files: a fingerprint, then the numbers of finished frames.

    It is removed when the run is complete or has written no frame, and kept if it is interrupted.

    Attributes:
        is_resumed: whether an earlier run with the same fingerprint was stopped.
        earlier: numbers of frames that it finished.
    """

    def __init__(
        self, path: Path | None = None, fingerprint: str = "", plan: VideoPlan | None = None
    ) -> None:
        """Read the journal of an earlier run, and begin to write; none without a path.

        Frames with another ``fingerprint`` of input, model and options do not count.
        """
        self._path, self._file, self._plan = path, None, plan
        self.is_resumed, self.earlier = False, frozenset[int]()
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        earlier = _finished(path, fingerprint)
        self.is_resumed, self.earlier = earlier is not None, earlier or frozenset()
        self._count = len(self.earlier)
        path.unlink(missing_ok=True)
        self._file = path.open("x", encoding="utf-8")
        lines = (json.dumps(fingerprint), *map(str, sorted(self.earlier)))
        self._file.write("".join(f"{line}\n" for line in lines))
        self._file.flush()

    def add(self, number: int) -> None:
        """Record that all files of a frame are written."""
        if self._file is not None and number not in self.earlier:
            self._file.write(f"{number}\n")
            self._file.flush()
            self._count += 1

    def depth(self, number: int) -> Float32Array | None:
        """Depth of a frame in the files of an earlier run, (H, W); None if it is to be predicted.

        All other outputs are made of it. Thread-safe.
        """
        if self._plan is None or number not in self.earlier:
            return None
        names = [self._plan.names.get(VideoFormat(format_)) for format_ in READABLE]  # best first
        paths = [self._plan.folder / numbered_name(name, number) for name in names if name]
        try:
            maps = [read_stored_depth(path).displayed for path in paths]
        except InputError:
            return None
        return maps[0].values

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._path is None or self._file is None:
            return
        with suppress(OSError):  # of a full disk, which add has reported already
            self._file.close()
        if kind is None or not self._count:
            self._path.unlink(missing_ok=True)


def _finished(path: Path, fingerprint: str) -> frozenset[int] | None:
    """Numbers of frames that a run with this fingerprint finished; None without such a run."""
    if path.is_symlink() or not path.is_file():
        return None
    head, *lines = path.read_text("utf-8", "replace").splitlines() or [""]
    if head != json.dumps(fingerprint):
        return None
    return frozenset(int(line) for line in lines if _NUMBER.fullmatch(line))


def rounding_scale(plan: VideoPlan, pipeline: Pipeline) -> float | None:
    """Units per metre to which depth is rounded before it is used; None for no rounding.

    Depth is rounded if all depth outputs are 16-bit, so that previews and figures are computed from
    the values that are written, and are the same whether or not the run was resumed. Normals of
    rounded depth would be those of its steps.
    """
    settings, writing = plan.settings, plan.settings.writing
    is_in_steps = {VideoFormat.MKV, VideoFormat.PNG16} & set(plan.names)
    is_finer = any(format_.facts.is_exact or format_ in _NORMALS for format_ in plan.names)
    is_metric = bool(settings.anchors) or pipeline.card.output.kind is DepthKind.METRIC
    is_stretched = settings.smooth_s or writing.is_normalized
    if is_stretched or is_finer or not (is_in_steps and is_metric):
        return None
    return writing.units_per_metre


def open_journal(
    plan: VideoPlan, source: FrameSource, pipeline: Pipeline, anchors: KnownDepthOfFrames
) -> FrameJournal:
    """The record of this run, and of an earlier one if it can be resumed.

    Only numbered files are kept. A run cannot be resumed with smoothing, as frames then depend on
    previous ones; in an object store; or if the other outputs cannot be made from the depth that is
    kept. The record of an earlier run is removed then, because this run replaces its frames.
    """
    numbered = [kind for kind in plan.names if kind in SEQUENCES]
    if not numbered or isinstance(plan.folder, RemotePath):
        return FrameJournal()
    path = plan.folder / f".{base_name(plan.names[numbered[0]])}.depthcli-frames"
    is_whole = rounding_scale(plan, pipeline) is not None or any(
        kind.facts.is_exact and not (plan.settings.writing.half and "half" in kind.facts.options)
        for kind in numbered
    )
    is_alone = set(plan.names) <= set(SEQUENCES)
    is_readable = any(SEQUENCES[kind].facts.is_readable for kind in numbered)
    can_resume = not plan.settings.smooth_s and bool(source.paths) and (is_whole or is_alone)
    can_resume &= is_readable
    with os_errors_as(OutputError, f"cannot write into {plan.folder}", "choose another {out}"):
        if can_resume:
            return FrameJournal(path, _origin(plan, source, pipeline, anchors), plan)
        path.unlink(missing_ok=True)
    return FrameJournal()


def _origin(
    plan: VideoPlan, source: FrameSource, pipeline: Pipeline, anchors: KnownDepthOfFrames
) -> str:
    settings = plan.settings
    # A broken link in a sequence costs no other image.
    states = [(path, path.stat() if path.exists() else path.lstat()) for path in source.paths]
    return fingerprint(
        __version__,
        plan.sha256 or [(path, state.st_size, state.st_mtime_ns) for path, state in states],
        plan.names,
        pipeline.session.identity(knows_depth=settings.takes_known_depth),
        pipeline.detail,
        (settings.writing, settings.camera, settings.reading, settings.span),
        (settings.fps, settings.stream, settings.start_number),
        anchors.states(),
    )
