"""What is to be done for one input, and what became of it; both can go to another process."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from depthcli.errors import (
    NO_THREADS,
    DepthcliError,
    ModelError,
    is_out_of_memory,
    is_out_of_threads,
)
from depthcli.inference.session import Session
from depthcli.inference.trial import try_session
from depthcli.io.listing.folder import InputFile
from depthcli.io.manifest.row import FAILED, OK, Origin, Row, is_intact
from depthcli.io.writers.formats import Format
from depthcli.video.formats import VideoFormat

_Which = TypeVar("_Which", Format, VideoFormat)


@dataclass(frozen=True, slots=True)
class Result:
    """What became of an input."""

    row: Row  #: its row in the manifest
    is_kept: bool = False  #: whether the outputs of an earlier run were still right


@dataclass(frozen=True, slots=True)
class Task(Generic[_Which]):
    """One input."""

    input: InputFile  #: the file
    outputs: Mapping[_Which, Path]  #: where each format goes; a sequence's name holds ``%06d``
    earlier: Row | None = None  #: the row of an earlier run, if its outputs have these names
    is_suspect: bool = False  #: whether decoding it may have ended the process of an earlier run

    def kept(self, out: Path, sha256: str, origin: Origin) -> Row | None:
        """The earlier row, if doing the input again could only give the same.

        Args:
            out: the output folder.
            sha256: checksum of the input.
            origin: what its outputs would follow from.
        """
        row = self.earlier
        if row is None or (row.status, row.input_sha256, row.origin) != (OK, sha256, origin):
            return None
        return row if all(is_intact(out, file) for file in row.outputs) else None

    def failed(
        self, error: Exception, origin: Origin, start_s: float, sha256: str | None
    ) -> Result:
        """The result of an input that an error stopped.

        Args:
            error: why.
            origin: model and options.
            start_s: when work on the input began, by ``time.perf_counter``.
            sha256: checksum of the input; None if it could not be read.
        """
        seconds = time.perf_counter() - start_s
        row = Row(
            input=self.input.name,
            status=FAILED,
            origin=origin,
            seconds=seconds,
            input_sha256=sha256,
            error=reason(error),
        )
        return Result(row)


def check_network(error: Exception, session: Session) -> None:
    """Do nothing if an error is the input's: a network that fails on one may do the next.

    Raises:
        ModelError: the network fails on a plain gray picture, too.
    """
    if isinstance(error, ModelError):
        try_session(session)


def reason(error: Exception) -> str:
    """Why an input failed, in one line."""
    if isinstance(error, DepthcliError):
        return str(error)
    if is_out_of_memory(error):
        return "does not fit into memory; make it smaller"
    if is_out_of_threads(error):
        return NO_THREADS
    if isinstance(error, OSError) and error.strerror:  # too many open files, say
        return ": ".join(filter(None, (error.filename and str(error.filename), error.strerror)))
    return f"unexpected {type(error).__name__}: {error}"
