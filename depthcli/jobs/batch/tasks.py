"""The task and the result of one input; both can be pickled.

Inputs that may have crashed an earlier batch; they are decoded in a subprocess first.

A decoder that crashes ends the whole process, and its input gets no row. That input is among the
first ones without a row, as workers start inputs in order.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Intrinsics
from depthcli.core.fingerprint import fingerprint
from depthcli.errors import InputError, UsageError
from depthcli.io.formats.table import FORMATS, Format
from depthcli.io.listing.folder import InputFile, RealPaths, is_video
from depthcli.io.manifest.journal import Rows
from depthcli.io.manifest.row import FAILED, OK, Origin, Row, is_intact
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.guard import Guard
from depthcli.io.storage.objects import masked
from depthcli.io.storage.paths import is_remote, path_of
from depthcli.jobs.batch.plan import Plan
from depthcli.jobs.write import failure_reason, output_guard
from depthcli.video.formats import COUNTERPARTS, VIDEO_FORMATS, VideoFormat

_FormatT = TypeVar("_FormatT", Format, VideoFormat)


@dataclass(frozen=True, slots=True)
class Result:
    """The result of an input."""

    row: Row  #: its row in the manifest
    is_kept: bool = False  #: whether the outputs of an earlier run were still valid


@dataclass(frozen=True, slots=True)
class Task(Generic[_FormatT]):
    """One input to process."""

    input: InputFile  #: the file
    outputs: Mapping[_FormatT, Path]  #: path of each format; a sequence's has ``%06d`` in its name
    earlier: Row | None = None  #: the row of an earlier run; None if it has none
    is_suspect: bool = False  #: whether decoding it may have crashed an earlier run
    shares_stem: bool = False  #: whether another picture has its name but for the suffix
    lens: Intrinsics | None = None  #: its own camera; None for that of the batch, if it has one
    has_names: bool = True  #: whether the outputs of the earlier run have these names

    @property
    def input_path(self) -> str:
        """Full path of the input, or its URI without password and signature."""
        try:
            return str(path_of(self.input.path).absolute())
        except UsageError:  # a listed URI that cannot be used, as its problem says
            return masked(self.input.path)

    def origin(self, batch: Origin) -> Origin:
        """Model and options that its outputs are made with: those of the batch, and its lens."""
        if self.lens is None:
            return batch
        return replace(batch, options_sha256=fingerprint(batch.options_sha256, self.lens))

    def reusable_row(
        self, out: Path, sha256: str, origin: Origin, points: AnchorPoints | None = None
    ) -> Row | None:
        """The earlier row, if processing the input again would give the same outputs.

        Args:
            out: the output folder.
            sha256: checksum of the input.
            origin: model and options of the batch.
            points: known depth that they would be fitted to; None for none.

        Raises:
            UsageError: the outputs are those of another file, which is still there.
        """
        row, now = self.earlier, (OK, sha256, self.origin(origin))
        if row is None:
            return None
        self._check_same_input(row, sha256, out)
        if not self.has_names or (row.status, row.input_sha256, row.origin) != now:
            return None
        if (row.anchors and row.anchors.sha256) != (None if points is None else points.sha256()):
            return None
        return row if all(is_intact(out, file) for file in row.outputs) else None

    def guard(self, *, overwrite: bool) -> Guard:
        """Check the outputs; returns the guard for writing them.

        Args:
            overwrite: whether files of other programs may be replaced.

        Raises:
            OutputError: one is the input, or a file that depthcli did not write.
        """
        inputs = [path_of(self.input.path)]
        return output_guard(inputs, overwrite=overwrite or self.is_listed).checked(
            self.outputs.values()
        )

    @property
    def is_listed(self) -> bool:
        """Whether the manifest lists files of these names as its outputs."""
        return self.earlier is not None and self.has_names

    def _check_same_input(self, row: Row, sha256: str, out: Path) -> None:
        """Refuse to replace the outputs of a file of the same name in another folder.

        The content decides first, so that a copy of the folder resumes the batch.
        """
        if row.input_sha256 == sha256:
            return
        other = self._other_input(row)
        if other is not None:
            raise self._taken_error(row, other, out)

    def check_sizes(self, out: Path) -> None:
        """Check as far as sizes tell that earlier outputs are not those of another file.

        Raises:
            UsageError: they are, and that file is still there.
        """
        row = self.earlier
        if row is None or row.input_path is None or self.input.problem is not None:
            return
        if is_remote(self.input.path) or is_remote(row.input_path):
            return  # in a store, each size costs a request
        other = self._other_input(row)
        with suppress(OSError):  # of a file that cannot be read, which fails later
            if other and path_of(self.input.path).stat().st_size != other.stat().st_size:
                raise self._taken_error(row, other, out)

    def _other_input(self, row: Row) -> Path | None:
        """The file that earlier outputs were made from, if it is another one and still there."""
        if row.input_path is None or not row.outputs or row.input_path == self.input_path:
            return None
        other = path_of(str(row.input_path))
        with suppress(OSError):
            if other.exists() and not is_same_file(path_of(self.input.path), other):
                return other
        return None

    def _taken_error(self, row: Row, other: Path, out: Path) -> UsageError:
        return UsageError(
            f"{out / row.outputs[0].path} is the output for {other}, not for {self.input_path}; "
            f"choose another --out, or delete the manifest in {out} to replace such outputs"
        )

    def failed_result(
        self, error: Exception, origin: Origin, start_s: float, sha256: str | None
    ) -> Result:
        """The result of an input that failed.

        Args:
            error: why.
            origin: model and options of the batch.
            start_s: start of the work on the input, by ``time.perf_counter``.
            sha256: checksum of the input; None if it could not be read.
        """
        seconds = time.perf_counter() - start_s
        row = Row(
            input=self.input.name,
            status=FAILED,
            origin=self.origin(origin),
            seconds=seconds,
            input_sha256=sha256,
            input_path=self.input_path,
            error=failure_reason(error),
        )
        return Result(row)


_CRASH_TEXT = "ends the process that decodes it"
_DECODE_PICTURE = """
import sys
from depthcli.io.images.read import read_image
read_image(None, sys.stdin.buffer.read())
"""
_DECODE_VIDEO = """
import sys
from depthcli.video.source import VideoSource
for _ in VideoSource(sys.argv[1]).frames(): pass
"""
_CRASH_SIGNALS = {
    -getattr(signal, name)
    for name in ("SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGKILL", "SIGSEGV")
    if hasattr(signal, name)
}


def mark_suspects(
    tasks: Iterable[Task[_FormatT]], rows: Rows, count: int
) -> Iterator[Task[_FormatT]]:
    """The tasks, with the first ``count`` of those without a row marked as suspects."""
    for task in tasks:
        if count and rows.row(task.input.name) is None:
            count -= 1
            yield replace(task, is_suspect=True)
        else:
            yield task


def has_crashed(row: Row | None) -> bool:
    """Whether the row says that decoding crashed; a later run may have another decoder."""
    return row is not None and _CRASH_TEXT in (row.error or "")


def check_picture(name: str, data: bytes) -> None:
    """Decode a picture in a subprocess.

    Raises:
        InputError: the subprocess crashed; other errors are left to the caller's own decoding.
    """
    _decode_in_subprocess(name, [_DECODE_PICTURE], data)


def check_video(name: str, path: Path) -> None:
    """Decode a video in a subprocess, as :func:`check_picture` does."""
    _decode_in_subprocess(name, [_DECODE_VIDEO, str(path)], b"")


def _decode_in_subprocess(name: str, arguments: list[str], data: bytes) -> None:
    command = [sys.executable, "-P", "-c", *arguments]
    done = subprocess.run(command, input=data, capture_output=True, check=False)  # noqa: S603 - our own
    if done.returncode in _CRASH_SIGNALS:
        by = signal.Signals(-done.returncode).name
        raise InputError(f"{name} {_CRASH_TEXT} ({by}); save it again with another program")


_MAX_SAME = 1000


@dataclass(frozen=True, slots=True)
class OutputMap:
    """Maps each input of a batch to its outputs."""

    plan: Plan  #: all inputs
    formats: tuple[Format, ...]  #: formats for pictures; videos get their counterparts

    def check_conflicts(self) -> None:
        """Refuse outputs that would replace inputs; files of a list can lie anywhere.

        Raises:
            UsageError: an output is an input.
        """
        places, taken = RealPaths(), set(self.plan.inputs_in_out)
        inside = os.path.realpath(self.plan.out)
        folders = map(Path, map(os.path.realpath, self.plan.folders()))
        if not all(folder.is_relative_to(inside) for folder in folders):
            # Through a link, outputs go to another folder, which may contain inputs.
            taken.update(*(places.all_of(file.path) for file in self.plan.inputs))
        for file in self.plan.inputs if taken else ():
            for path in self.of(file).values():
                if places.of(path) in taken:
                    raise UsageError(
                        f"{path}, the output for {file.name}, is an input; choose another --out"
                    )

    def check_earlier(self, rows: Rows) -> None:
        """Check as far as sizes tell that no earlier output is that of another file.

        A batch of the same folder is known by its first rows; the others are not read twice.

        Raises:
            UsageError: one is, and that file is still there.
        """
        same = 0
        for file in self.plan.inputs:
            task: Task[Format] = Task(file, {}, rows.row(file.name))
            task.check_sizes(self.plan.out)
            same += task.earlier is not None and task.earlier.input_path == task.input_path
            if same == _MAX_SAME:
                return

    def of(self, file: InputFile) -> dict[Format, Path] | dict[VideoFormat, Path]:
        """Paths of the outputs of an input."""
        return self._of_video(file) if is_video(file.name) else self._of_picture(file)

    def picture(self, file: InputFile, rows: Rows) -> Task[Format]:
        """The task for a picture, given the rows of earlier batches."""
        outputs, row = self._of_picture(file), rows.row(file.name)
        has_names = row is not None and self._names(outputs.values()) == _made_names(row)
        if not has_names:
            file = self._unless_taken(file, outputs.values(), rows)
        shares_stem = self.plan.stems.is_shared(file.name)
        lens = self.plan.lenses.get(file.name)
        return Task(file, outputs, row, has_crashed(row), shares_stem, lens, has_names)

    def video(self, file: InputFile, rows: Rows) -> Task[VideoFormat]:
        """The task for a video, given the rows of earlier batches."""
        outputs, row = self._of_video(file), rows.row(file.name)
        has_names = row is not None and self._names(outputs.values()) == _sequence_names(row)
        if not has_names:
            file = self._unless_taken(file, outputs.values(), rows)
        lens = self.plan.lenses.get(file.name)
        return Task(file, outputs, row, has_crashed(row), lens=lens, has_names=has_names)

    def _unless_taken(self, file: InputFile, outputs: Iterable[Path], rows: Rows) -> InputFile:
        """The input, with a problem if its output is that of a file which is left out."""
        names = self._names(outputs)
        for other in self.plan.unlisted.get(file.name, ()):
            row = rows.row(other)
            for taken in names & (_made_names(row) | _sequence_names(row)) if row else ():
                return file._replace(
                    problem=f"{self.plan.out / taken} is the output for {other}, which "
                    "this batch leaves out; list both, or choose another --out"
                )
        return file

    def _names(self, outputs: Iterable[Path]) -> set[str]:
        return {path.relative_to(self.plan.out).as_posix() for path in outputs}

    def _of_picture(self, file: InputFile) -> dict[Format, Path]:
        base = self.plan.names.base(file.name)
        return {which: self.plan.out / (base + FORMATS[which].suffix) for which in self.formats}

    def _of_video(self, file: InputFile) -> dict[VideoFormat, Path]:
        base = self.plan.names.base(file.name)
        chosen = [COUNTERPARTS[which] for which in self.formats if which in COUNTERPARTS]
        return {which: self.plan.out / (base + VIDEO_FORMATS[which].suffix) for which in chosen}


def _made_names(row: Row) -> set[str]:
    """Names of the outputs of an earlier run, relative to the output folder."""
    return {file.path for file in row.outputs}


def _sequence_names(row: Row) -> set[str]:
    """The same for a video, whose frames have the name of their sequence: their number varies."""
    return {re.sub(r"(?<=\.depth\.)\d{6,}(?=\.\w+$)", "%06d", name) for name in _made_names(row)}
