"""Processing pictures one after another, from the file to the outputs."""

import sys
import time
from collections.abc import Iterator, Sequence

from depthcli.core.anchors import AnchorPoints
from depthcli.core.parallel import Background
from depthcli.core.types import displayed_depth
from depthcli.errors import InputError, ModelError, OutputError, UsageError, is_out_of_memory
from depthcli.inference.camera import focal_warnings
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.io.depth.anchors import AnchorFiles
from depthcli.io.formats.table import Format, writer_class
from depthcli.io.storage.atomic import Guard
from depthcli.io.storage.paths import path_of
from depthcli.jobs import write
from depthcli.jobs.outputs import Kind, OutputPlan
from depthcli.jobs.predict import PictureResult, PredictRequest


def predict_pictures(
    request: PredictRequest, plans: Sequence[OutputPlan[Format]], loading: Background[Session]
) -> Iterator[PictureResult | write.FailedInput]:
    """Process the images and yield their results, in order; raises as ``predict`` states."""
    anchors = request.anchors
    own = anchors if isinstance(anchors, AnchorFiles) and anchors.is_by_image else None
    try:
        points = None if own else request.known_points()
    except InputError as error:
        raise UsageError(error.message, option="anchors") from error
    for name in {name for plan in plans for name in plan.outputs}:
        writer_class(name)  # imported while the model loads
    known = [] if isinstance(anchors, tuple) or own else [path_of(anchors.path)]
    inputs = [*known, *(plan.source for plan in plans if plan.source is not None)]
    guard = Guard.of(inputs, overwrite=request.overwrite)
    for plan in plans:
        try:
            to_files = request.destination.kind is not Kind.STDOUT
            guard.check(*plan.outputs.values() if to_files else ())
            if own:
                points = request.known_points(plan.source)
            yield _predict_picture(request, plan, loading, points)
        except (InputError, OutputError) as error:
            yield write.FailedInput(plan.name, error)
        except ModelError as error:
            from depthcli.inference.trial import check_network  # noqa: PLC0415 - seldom needed

            check_network(error, loading.result())
            yield write.FailedInput(plan.name, error)
        except Exception as error:
            if not is_out_of_memory(error):
                raise
            yield write.FailedInput(plan.name, InputError(write.failure_reason(error)))
    loading.result()  # raises if the model cannot be loaded, even if no picture was read


def _predict_picture(
    request: PredictRequest,
    plan: OutputPlan[Format],
    loading: Background[Session],
    points: AnchorPoints | None,
) -> PictureResult:
    start = time.perf_counter()
    try:
        data = None if plan.source else (request.stdin or sys.stdin.buffer).read()
        frame = request.read(plan.source, data)
    except OSError as error:
        raise InputError(f"cannot read standard input: {error.strerror}") from error
    session = loading.result()
    depth, depth_warnings = Pipeline(session, request.detail).predict(frame, request.camera, points)
    warnings = [*session.warnings, *frame.warnings, *depth_warnings]
    if not points:
        warnings += focal_warnings(session.model.card, request.camera)
    for name, path in plan.outputs.items():
        if request.destination.kind is Kind.STDOUT:
            stream = request.stdout or sys.stdout.buffer
            warnings += write.write_stream(request.writing, name, depth, frame, stream)
        else:
            warnings += write.write_output(request.writing, name, depth, frame, path)
    shown, outputs = displayed_depth(depth, frame.windows), tuple(map(str, plan.outputs.values()))
    seconds, texts = time.perf_counter() - start, tuple(dict.fromkeys(warnings))
    return PictureResult(plan.name, outputs, shown, session.provider, seconds, warnings=texts)
