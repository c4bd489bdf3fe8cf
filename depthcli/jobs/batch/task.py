"""The task and the result of one input; both can be pickled."""

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Intrinsics
from depthcli.core.fingerprint import fingerprint
from depthcli.errors import UsageError
from depthcli.io.formats.table import Format
from depthcli.io.listing.folder import InputFile
from depthcli.io.manifest.row import FAILED, OK, Origin, Row, is_intact
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.guard import Guard
from depthcli.io.storage.objects import masked
from depthcli.io.storage.remote import is_remote, path_of
from depthcli.jobs.failed import failure_reason
from depthcli.jobs.outputs import output_guard
from depthcli.video.formats import VideoFormat

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
