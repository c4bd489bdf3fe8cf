"""Resuming a video that was stopped, with the numbered files that the earlier run wrote."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from depthcli._version import __version__
from depthcli.core.types import DepthKind, Float32Array
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, OutputError, os_errors_as
from depthcli.inference.pipeline import Pipeline
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.table import READABLE
from depthcli.io.storage.paths import RemotePath
from depthcli.jobs.video.plan import VideoPlan
from depthcli.known.sources import KnownDepthOfFrames
from depthcli.video import formats, frames, numbering

_NORMALS = (formats.VideoFormat.NORMALS, formats.VideoFormat.NORMALS_EXR)
_NUMBER = re.compile(r"[0-9]{1,18}")


@dataclass(slots=True)
class FrameJournal:
    """The frames that are finished, by an earlier run with the same fingerprint or by this one."""

    plan: VideoPlan | None = None  #: of the numbered files; None if frames are not recorded
    done: set[int] = field(default_factory=set)  #: numbers of the frames
    is_resumed: bool = False  #: whether there was such a run, which was stopped
    file: TextIO | None = None  #: where frames are recorded

    def add(self, number: int) -> None:
        """Record that all files of a frame are written."""
        if self.file is not None and number not in self.done:
            self.file.write(f"{number}\n")
            self.file.flush()
            self.done.add(number)

    def depth(self, number: int) -> Float32Array | None:
        """Depth of a frame in the files of an earlier run, (H, W); None if it is to be predicted.

        All other outputs are made of it. Thread-safe.
        """
        if self.plan is None or number not in self.done:
            return None
        names = [
            self.plan.names.get(formats.VideoFormat(format_)) for format_ in READABLE
        ]  # best first
        paths = [self.plan.folder / numbering.numbered_name(name, number) for name in names if name]
        try:
            maps = [read_stored_depth(path).displayed for path in paths]
        except InputError:
            return None
        return maps[0].values


def finished_frames(path: Path, fingerprint: str) -> set[int] | None:
    """Numbers of frames that a run with this fingerprint finished; None without such a run."""
    if not path.is_file():
        return None
    head, *lines = path.read_text("utf-8", "replace").splitlines() or [""]
    if head != json.dumps(fingerprint):
        return None
    return {int(line) for line in lines if _NUMBER.fullmatch(line)}


def rounding_scale(plan: VideoPlan, pipeline: Pipeline) -> float | None:
    """Units per metre to which depth is rounded before it is used; None for no rounding.

    Depth is rounded if all depth outputs are 16-bit, so that previews and figures are computed from
    the values that are written, and are the same whether or not the run was resumed. Normals of
    rounded depth would be those of its steps.
    """
    settings, writing = plan.settings, plan.settings.writing
    is_in_steps = {formats.VideoFormat.MKV, formats.VideoFormat.PNG16} & set(plan.names)
    is_finer = any(format_.facts.is_exact or format_ in _NORMALS for format_ in plan.names)
    is_metric = bool(settings.anchors) or pipeline.card.output.kind is DepthKind.METRIC
    is_stretched = settings.smooth_s or writing.is_normalized
    if is_stretched or is_finer or not (is_in_steps and is_metric):
        return None
    return writing.units_per_metre


@contextmanager
def open_journal(
    plan: VideoPlan, source: frames.FrameSource, pipeline: Pipeline, anchors: KnownDepthOfFrames
) -> Iterator[FrameJournal]:
    """The record of this run, and of an earlier one if it can be resumed.

    It is a hidden file beside numbered files: a fingerprint of input, model and options, then the
    numbers of finished frames. It is removed when the run is complete or has written no frame, and
    kept if it is interrupted.

    Only numbered files are kept. A run cannot be resumed with smoothing, as frames then depend on
    previous ones; in an object store; or if the other outputs cannot be made from the depth that is
    kept. The record of an earlier run is removed then, because this run replaces its frames.
    """
    numbered = [kind for kind in plan.names if kind in formats.SEQUENCES]
    if not numbered or isinstance(plan.folder, RemotePath):
        yield FrameJournal()
        return
    path = plan.folder / f".{numbering.base_name(plan.names[numbered[0]])}.depthcli-frames"
    is_whole = rounding_scale(plan, pipeline) is not None or any(
        kind.facts.is_exact and not (plan.settings.writing.half and "half" in kind.facts.options)
        for kind in numbered
    )
    is_alone = set(plan.names) <= set(formats.SEQUENCES)
    is_readable = any(formats.SEQUENCES[kind].facts.is_readable for kind in numbered)
    can_resume = not plan.settings.smooth_s and bool(source.paths) and (is_whole or is_alone)
    can_resume &= is_readable
    with os_errors_as(OutputError, f"cannot write into {plan.folder}", "choose another {out}"):
        journal = FrameJournal()
        origin = _origin(plan, source, pipeline, anchors) if can_resume else ""
        earlier = finished_frames(path, origin)
        path.unlink(missing_ok=True)
        if can_resume:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("x", encoding="utf-8")
            journal = FrameJournal(plan, earlier or set(), earlier is not None, file)
            file.writelines(f"{line}\n" for line in (json.dumps(origin), *sorted(journal.done)))
            file.flush()
    is_kept = True
    try:
        yield journal
        is_kept = False
    finally:
        if journal.file is not None:
            with suppress(OSError):  # of a full disk, which add has reported already
                journal.file.close()
            if not (is_kept and journal.done):
                path.unlink(missing_ok=True)


def _origin(
    plan: VideoPlan, source: frames.FrameSource, pipeline: Pipeline, anchors: KnownDepthOfFrames
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
