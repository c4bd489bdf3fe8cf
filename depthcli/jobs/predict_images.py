"""Predicting images one after another; imported while the model loads, as it needs numpy."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from depthcli.core.parallel import Background
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, ModelError, OutputError, UsageError, is_out_of_memory
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.io.formats.table import Format, writer_class
from depthcli.io.guard import Guard
from depthcli.io.storage.paths import path_of
from depthcli.jobs.image import FailedInput, ImageJob, ImageTask, Target, failure_reason
from depthcli.jobs.outputs import MapOptions, OutputPlan
from depthcli.known.files import KnownDepthFiles

if TYPE_CHECKING:
    from typing import BinaryIO


class PredictResult(NamedTuple):
    """The result of an input whose outputs are all written."""

    name: str  #: the input, as the user wrote it
    outputs: tuple[str, ...]  #: the files written, ``-`` for standard output
    depth: DepthMap  #: the depth map, of an EXR that of its display window
    provider: str  #: the provider that ran the model
    seconds: float  #: from opening the input to the last output
    warnings: tuple[str, ...]  #: one line each


def predict_images(
    options: MapOptions,
    plans: Sequence[OutputPlan[Format]],
    loading: Background[Session],
    *,
    overwrite: bool,
    stdin: BinaryIO | None = None,
    stdout: BinaryIO | None = None,
) -> Iterator[PredictResult | FailedInput]:
    """Process the images and yield their results, in order; raises as ``predict`` states.

    ``stdout`` takes the outputs in place of files; ``stdin`` is read where a plan has no source.
    """
    anchors = options.anchors
    is_by_image = isinstance(anchors, KnownDepthFiles) and anchors.is_by_image
    try:
        points = None if is_by_image else options.known_points()
    except InputError as error:
        raise UsageError(error.message, option="anchors") from error
    for name in {name for plan in plans for name in plan.outputs}:
        writer_class(name)  # imported while the model loads
    shared = (
        [path_of(anchors.path)] if isinstance(anchors, KnownDepthFiles) and not is_by_image else []
    )
    inputs = [*shared, *(plan.source for plan in plans if plan.source is not None)]
    guard = Guard.of(inputs, overwrite=overwrite)
    for plan in plans:
        try:
            start_s = time.perf_counter()
            guard.check(*plan.outputs.values() if stdout is None else ())
            if is_by_image:
                points = options.known_points(plan.source)
            frame = _read(options, plan.source, stdin)
            targets: Mapping[Format, Target] = plan.outputs
            if stdout is not None:
                targets = dict.fromkeys(plan.outputs, stdout)
            image = ImageTask(frame, options.camera, points, targets)
            yield _predict_image(plan, image, options, loading.result(), start_s)
        except (InputError, OutputError) as error:
            yield FailedInput(plan.name, error)
        except ModelError as error:
            from depthcli.inference.pipeline import check_network  # noqa: PLC0415 - seldom needed

            check_network(error, loading.result())
            yield FailedInput(plan.name, error)
        except Exception as error:
            if not is_out_of_memory(error):
                raise
            yield FailedInput(plan.name, InputError(failure_reason(error)))
    loading.result()  # raises if the model cannot be loaded, even if no image was read


def _read(options: MapOptions, path: Path | None, stdin: BinaryIO | None) -> Frame:
    try:
        data = None if path else (stdin or sys.stdin.buffer).read()
        return options.read(path, data)
    except OSError as error:
        raise InputError(f"cannot read standard input: {error.strerror}") from error


def _predict_image(
    plan: OutputPlan[Format],
    image: ImageTask,
    options: MapOptions,
    session: Session,
    start_s: float,
) -> PredictResult:
    done = ImageJob(Pipeline(session, options.detail), options.writing).run(image)
    return PredictResult(
        plan.name,
        tuple(map(str, plan.outputs.values())),
        done.depth,
        session.provider,
        time.perf_counter() - start_s,
        tuple(dict.fromkeys((*session.warnings, *done.warnings))),
    )
