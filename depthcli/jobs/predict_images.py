"""Predicting images one after another; imported while the model loads, as it needs numpy."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from depthcli.core.parallel import Background
from depthcli.core.types import DepthMap
from depthcli.errors import InputError, ModelError, OutputError, UsageError, is_out_of_memory
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.io.depth.anchors import AnchorFiles
from depthcli.io.formats.table import Format, writer_class
from depthcli.io.storage.atomic import Guard
from depthcli.io.storage.paths import path_of
from depthcli.jobs.image import FailedInput, ImageJob, ImageTask, Target, failure_reason
from depthcli.jobs.outputs import Kind, OutputPlan

if TYPE_CHECKING:
    from depthcli.core.anchors import AnchorPoints
    from depthcli.jobs.predict import PredictRequest


class PredictResult(NamedTuple):
    """The result of an input whose outputs are all written."""

    name: str  #: the input, as the user wrote it
    outputs: tuple[str, ...]  #: the files written, ``-`` for standard output
    depth: DepthMap  #: the depth map, of an EXR that of its display window
    provider: str  #: the provider that ran the model
    seconds: float  #: from opening the input to the last output
    warnings: tuple[str, ...]  #: one line each


def predict_images(
    request: PredictRequest, plans: Sequence[OutputPlan[Format]], loading: Background[Session]
) -> Iterator[PredictResult | FailedInput]:
    """Process the images and yield their results, in order; raises as ``predict`` states."""
    anchors = request.anchors
    is_by_image = isinstance(anchors, AnchorFiles) and anchors.is_by_image
    try:
        points = None if is_by_image else request.known_points()
    except InputError as error:
        raise UsageError(error.message, option="anchors") from error
    for name in {name for plan in plans for name in plan.outputs}:
        writer_class(name)  # imported while the model loads
    shared = [path_of(anchors.path)] if isinstance(anchors, AnchorFiles) and not is_by_image else []
    inputs = [*shared, *(plan.source for plan in plans if plan.source is not None)]
    guard = Guard.of(inputs, overwrite=request.overwrite)
    for plan in plans:
        try:
            to_files = request.destination.kind is not Kind.STDOUT
            guard.check(*plan.outputs.values() if to_files else ())
            if is_by_image:
                points = request.known_points(plan.source)
            yield _predict_image(request, plan, loading, points)
        except (InputError, OutputError) as error:
            yield FailedInput(plan.name, error)
        except ModelError as error:
            from depthcli.inference.trial import check_network  # noqa: PLC0415 - seldom needed

            check_network(error, loading.result())
            yield FailedInput(plan.name, error)
        except Exception as error:
            if not is_out_of_memory(error):
                raise
            yield FailedInput(plan.name, InputError(failure_reason(error)))
    loading.result()  # raises if the model cannot be loaded, even if no image was read


def _predict_image(
    request: PredictRequest,
    plan: OutputPlan[Format],
    loading: Background[Session],
    points: AnchorPoints | None,
) -> PredictResult:
    start = time.perf_counter()
    try:
        data = None if plan.source else (request.stdin or sys.stdin.buffer).read()
        frame = request.read(plan.source, data)
    except OSError as error:
        raise InputError(f"cannot read standard input: {error.strerror}") from error
    session = loading.result()
    targets: dict[Format, Target] = {**plan.outputs}
    if request.destination.kind is Kind.STDOUT:
        targets = dict.fromkeys(targets, request.stdout or sys.stdout.buffer)
    job = ImageJob(Pipeline(session, request.detail), request.writing)
    done = job.run(ImageTask(frame, request.camera, points, targets))
    warnings = tuple(dict.fromkeys((*session.warnings, *done.warnings)))
    outputs = tuple(map(str, plan.outputs.values()))
    seconds = time.perf_counter() - start
    return PredictResult(plan.name, outputs, done.depth, session.provider, seconds, warnings)
