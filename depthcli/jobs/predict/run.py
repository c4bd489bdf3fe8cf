"""What ``depthcli predict`` does: each picture through the model and into its files."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, NamedTuple

from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import ExitCode, InputError, OutputError
from depthcli.inference.pipeline import Pipeline
from depthcli.io.pictures.read import read_image
from depthcli.io.writers.formats import writer_class
from depthcli.jobs.predict.outcome import Done, Failed
from depthcli.jobs.predict.plan import STANDARD, write_output

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.core.camera import Camera
    from depthcli.core.choices import Detail
    from depthcli.core.parallel.background import Background
    from depthcli.core.picture_limit import PictureLimit
    from depthcli.core.types import DepthMap, Frame
    from depthcli.inference.session import Session
    from depthcli.io.writers.options import WriterOptions
    from depthcli.jobs.predict.plan import Job


class Voice(NamedTuple):
    """What is said of each input.

    Attributes:
        as_json: one JSON object a line in place of text.
        quiet: errors only.
        to_stderr: standard output carries a depth map, so text goes elsewhere.
    """

    as_json: bool
    quiet: bool
    to_stderr: bool

    def tell(self, outcome: Done | Failed) -> None:
        """Say what became of an input."""
        if self.as_json:
            console.out_json(outcome.as_json())
        if isinstance(outcome, Failed):
            console.error(outcome.as_text())
        elif not self.quiet and not self.as_json:
            (console.note if self.to_stderr else console.out)(outcome.as_text())
            for warning in outcome.warnings:
                console.warn(f"{outcome.name}: {warning}")


class Predictor(NamedTuple):
    """One run of the command.

    Attributes:
        loading: the model.
        camera: what is known of the camera.
        looks: options of the formats.
        detail: how depth becomes that of a full-size picture.
        limit: pictures beyond it are refused.
        voice: what is said.
    """

    loading: Background[Session]
    camera: Camera
    looks: WriterOptions
    detail: Detail
    limit: PictureLimit
    voice: Voice

    def run(self, jobs: Sequence[Job]) -> int:
        """Work off all inputs; a bad one never stops the others.

        Returns:
            The exit code.

        Raises:
            ModelError: the model cannot be used.
            UsageError: the model takes no focal length.
        """
        for name in {name for job in jobs for name in job.outputs}:
            writer_class(name)  # imported while the model loads
        failed = []
        for job in jobs:
            try:
                outcome: Done | Failed = self._one(job)
            except (InputError, OutputError) as error:
                outcome = Failed(job.name, error)
                failed.append(one_line(job.name) or "''")
            self.voice.tell(outcome)
        self.loading.result()  # a model that fails is told even if no picture got so far
        if failed and len(jobs) > 1:
            console.note(f"{len(failed)} of {len(jobs)} inputs failed: {', '.join(failed)}")
        return ExitCode.SOME_FAILED if failed else ExitCode.OK

    def _one(self, job: Job) -> Done:
        start = time.perf_counter()
        frame = _read(job, self.limit)
        pipeline = Pipeline(self.loading.result(), self.detail)
        depth = self._depth(pipeline, frame)
        warnings = list(pipeline.session.warnings)
        for name in job.outputs:
            warnings += write_output(self.looks, name, depth, frame, job)
        return Done(
            name=job.name,
            outputs=tuple(str(path or STANDARD) for path in job.outputs.values()),
            depth=depth,
            provider=pipeline.session.provider,
            seconds=time.perf_counter() - start,
            warnings=tuple(warnings),
        )

    def _depth(self, pipeline: Pipeline, frame: Frame) -> DepthMap:
        camera = self.camera
        depth = pipeline.predict(frame, focal_px=camera.focal_px, hfov_deg=camera.hfov_deg)
        return camera.fitted(depth)


def _read(job: Job, limit: PictureLimit) -> Frame:
    if not job.name:
        raise InputError("an input's name is empty; is a variable of the command not set?")
    data = sys.stdin.buffer.read() if job.source is None else None
    try:
        return read_image(job.source, data, max_pixels=limit)
    except MemoryError as error:
        raise InputError("does not fit into memory; make it smaller") from error
