"""One worker's turn: a few pictures from their files to their outputs."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from depthcli.errors import (
    DepthcliError,
    InputError,
    ModelError,
    UsageError,
    is_out_of_memory,
)
from depthcli.inference.trial import try_session
from depthcli.io.pictures.decode import read_bytes
from depthcli.io.pictures.read import read_image
from depthcli.jobs.batch.manifest import FAILED, OK, Row, written
from depthcli.jobs.outputs import write_output

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.core.types import DepthMap, Frame
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.listing.folder import Found
    from depthcli.jobs.batch.journal import Journal
    from depthcli.jobs.batch.recipe import Targets


class Result(NamedTuple):
    """What became of an input.

    Attributes:
        row: its row in the manifest.
        is_kept: whether the outputs of an earlier run were still right.
    """

    row: Row
    is_kept: bool


class _Opened(NamedTuple):
    """A picture on its way."""

    found: Found
    frame: Frame
    sha256: str
    seconds: float


class Worker:
    """Does inputs, and puts down their rows; safe for threads."""

    def __init__(self, targets: Targets, pipeline: Pipeline, journal: Journal) -> None:
        self._targets = targets
        self._recipe = targets.recipe
        self._pipeline = pipeline
        self._journal = journal

    def work(self, inputs: Sequence[Found]) -> list[Result]:
        """Do some inputs, their networks' turns together.

        Raises:
            ModelError: the network fails on any picture.
            UsageError: the options do not fit the model.
            OutputError: the journal cannot be written.
        """
        opened = [self._open(found) for found in inputs]
        frames = [one.frame for one in opened if isinstance(one, _Opened)]
        start = time.perf_counter()
        depths = iter(self._depths(frames))
        share_s = (time.perf_counter() - start) / max(1, len(frames))
        return [
            self._finish(one, next(depths), share_s) if isinstance(one, _Opened) else one
            for one in opened
        ]

    def _depths(self, frames: Sequence[Frame]) -> Sequence[DepthMap | Exception]:
        camera = self._recipe.camera
        try:
            return self._pipeline.predict_many(
                frames, focal_px=camera.focal_px, hfov_deg=camera.hfov_deg
            )
        except UsageError:
            raise
        except Exception as error:  # noqa: BLE001 - no picture may stop the others
            if len(frames) == 1:
                return [blame(error, self._pipeline)]
            return [depth for frame in frames for depth in self._depths([frame])]

    def _open(self, found: Found) -> _Opened | Result:
        start = time.perf_counter()
        sha256 = None
        try:
            data = read_input(found)
            sha256 = hashlib.sha256(data).hexdigest()
            row = self._targets.kept(found, sha256)
            if row is not None:
                return Result(row, is_kept=True)
            frame = read_image(Path(found.path), data, max_pixels=self._recipe.limit)
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return self._failed(found, error, start, sha256)
        return _Opened(found, frame, sha256, time.perf_counter() - start)

    def _finish(self, opened: _Opened, depth: DepthMap | Exception, share_s: float) -> Result:
        start = time.perf_counter() - opened.seconds - share_s
        found, outputs = opened.found, self._targets.of_picture(opened.found)
        if isinstance(depth, Exception):
            return self._failed(found, depth, start, opened.sha256)
        try:
            fitted = self._recipe.camera.fitted(depth)
            warnings: list[str] = []
            for name, path in outputs.items():
                warnings += write_output(self._recipe.looks, name, fitted, opened.frame, path)
            files = tuple(written(self._targets.plan.out, path) for path in outputs.values())
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return self._failed(found, error, start, opened.sha256)
        row = Row(
            input=found.name,
            status=OK,
            origin=self._targets.origin,
            outputs=files,
            seconds=time.perf_counter() - start,
            input_sha256=opened.sha256,
            warnings=tuple(warnings),
        )
        return self._put_down(row)

    def _failed(self, found: Found, error: Exception, start: float, sha256: str | None) -> Result:
        if isinstance(error, UsageError):
            raise error
        row = Row(
            input=found.name,
            status=FAILED,
            origin=self._targets.origin,
            seconds=time.perf_counter() - start,
            input_sha256=sha256,
            error=reason(error),
        )
        return self._put_down(row)

    def _put_down(self, row: Row) -> Result:
        """Add a row to the journal."""
        self._journal.add(row)
        return Result(row, is_kept=False)


def read_input(found: Found) -> bytes:
    """Content of an input.

    Raises:
        InputError: it cannot be read, or is no file: reading a pipe could take for ever.
    """
    if found.problem is not None:
        raise InputError(found.problem)
    try:
        mode = os.stat(found.path).st_mode  # noqa: PTH116 - names with any byte pass here
    except (OSError, ValueError):
        mode = stat.S_IFREG  # reading it says what is wrong
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise InputError(f"{found.path} is not a file but a pipe or a device; copy it to a file")
    return read_bytes(Path(found.path))


def blame(error: Exception, pipeline: Pipeline) -> Exception:
    """The error, if it is the input's: a network that fails on one picture may do the next.

    Raises:
        ModelError: the network fails on a plain gray picture, too.
    """
    if isinstance(error, ModelError):
        try_session(pipeline.session)
    return error


def reason(error: Exception) -> str:
    """Why an input failed, in one line."""
    if isinstance(error, DepthcliError):
        return str(error)
    if is_out_of_memory(error):
        return "does not fit into memory; make it smaller"
    return f"unexpected {type(error).__name__}: {error}"
