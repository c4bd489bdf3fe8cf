"""Processing pictures in a worker, from their files to their outputs."""

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from depthcli.core.anchors import AnchorPoints
from depthcli.core.overscan import displayed_depth
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import UsageError
from depthcli.inference.pipeline import Pipeline, Prediction
from depthcli.inference.trial import check_network
from depthcli.io.formats.metadata import camera_text
from depthcli.io.formats.table import Format
from depthcli.io.images.decode import read_bytes
from depthcli.io.images.read import read_image
from depthcli.io.listing.folder import InputFile
from depthcli.io.manifest.row import OK, AnchorEntry, Origin, Row, output_entry
from depthcli.io.storage.guard import Guard
from depthcli.io.storage.remote import path_of
from depthcli.jobs.batch.options import BatchOptions
from depthcli.jobs.batch.suspects import check_picture
from depthcli.jobs.batch.task import Result, Task
from depthcli.jobs.outputs import write_output

PictureTask: TypeAlias = Task[Format]


@dataclass(frozen=True, slots=True)
class _OpenedPicture:
    """A picture that was read."""

    task: PictureTask
    frame: Frame
    guard: Guard
    points: AnchorPoints | None
    sha256: str
    seconds: float


@dataclass(frozen=True, slots=True)
class PictureWorker:
    """Processes pictures; thread-safe."""

    options: BatchOptions  #: how each picture is processed
    out: Path  #: the output folder
    origin: Origin  #: model and options of the batch
    pipeline: Pipeline  #: the model

    def work(self, tasks: Sequence[PictureTask]) -> list[Result]:
        """Process some pictures; the network runs on them as one batch.

        Raises:
            ModelError: the network fails on any picture.
            UsageError: the options do not fit the model, or outputs are those of other inputs.
        """
        opened = [self._open(task) for task in tasks]
        readable = [one for one in opened if isinstance(one, _OpenedPicture)]
        start_s = time.perf_counter()
        predictions = iter(self._predictions(readable))
        share_s = (time.perf_counter() - start_s) / max(1, len(readable))
        return [
            self._finish(one, next(predictions), share_s)
            if isinstance(one, _OpenedPicture)
            else one
            for one in opened
        ]

    def _open(self, task: PictureTask) -> _OpenedPicture | Result:
        start_s = time.perf_counter()
        sha256 = None
        try:
            data = read_input(task.input)
            sha256 = hashlib.sha256(data).hexdigest()
            points = self.options.points_for(
                task.input, task.outputs.values(), shares_stem=task.shares_stem
            )
            row = task.reusable_row(self.out, sha256, self.origin, points)
            if row is not None:
                return Result(row, is_kept=True)
            guard = task.guard(overwrite=self.options.overwrite)
            if task.is_suspect:
                check_picture(task.input.path, data)
            frame = read_image(
                path_of(task.input.path),
                data,
                max_pixels=self.options.max_pixels,
                **self.options.reading._asdict(),
            )
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return self._failed(task, error, start_s, sha256)
        seconds = time.perf_counter() - start_s
        return _OpenedPicture(task, frame, guard, points, sha256, seconds)

    def _predictions(self, opened: Sequence[_OpenedPicture]) -> list[Prediction | Exception]:
        return self.pipeline.predict_many(
            [one.frame for one in opened],
            [self.options.camera.of_image(one.task.lens) for one in opened],
            [one.points for one in opened],
        )

    def _finish(
        self, opened: _OpenedPicture, found: Prediction | Exception, share_s: float
    ) -> Result:
        task = opened.task
        start_s = time.perf_counter() - opened.seconds - share_s
        if isinstance(found, Exception):
            check_network(found, self.pipeline.session)
            return self._failed(task, found, start_s, opened.sha256)
        depth = found.depth
        try:
            frame, points = opened.frame, opened.points
            warnings = [*frame.warnings, *found.warnings]
            for which, path in task.outputs.items():
                warnings += write_output(
                    self.options.writing, which, depth, frame, path, opened.guard
                )
            files = tuple(output_entry(self.out, path) for path in task.outputs.values())
        except Exception as error:  # noqa: BLE001 - no file may stop the others
            return self._failed(task, error, start_s, opened.sha256)
        row = Row(
            input=task.input.name,
            status=OK,
            origin=task.origin(self.origin),
            outputs=files,
            seconds=time.perf_counter() - start_s,
            input_sha256=opened.sha256,
            input_path=task.input_path,
            warnings=tuple(warnings),
            camera=camera_text(displayed_depth(depth, frame.windows)),
            anchors=anchor_entry(depth, points),
        )
        return Result(row)

    def _failed(
        self, task: PictureTask, error: Exception, start_s: float, sha256: str | None
    ) -> Result:
        if isinstance(error, UsageError):
            raise error
        return task.failed_result(error, self.origin, start_s, sha256)


def anchor_entry(depth: DepthMap, points: AnchorPoints | None) -> AnchorEntry | None:
    """The entry of the known points that a map was fitted to; None if it was not."""
    fit = depth.provenance.anchor_fit if depth.provenance else None
    if fit is None or points is None:
        return None
    return AnchorEntry(fit.given, fit.used, round(fit.residual_m, 6), points.sha256())


def read_input(file: InputFile) -> bytes:
    """Content of an input.

    Raises:
        InputError: it cannot be read, or is no file.
    """
    return read_bytes(file.readable_path())
