"""Predicting images, as ``depthcli predict`` does; free of numpy until a model loads."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from depthcli import errors
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import FILE_SUFFIXES, Format, format_of, stem_of, writer_class
from depthcli.io.guard import Guard, is_own_image
from depthcli.io.storage.paths import path_of, safe_name
from depthcli.jobs import outputs
from depthcli.jobs.outputs import STDIO, Destination, Kind, MapOptions, OutputPlan

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import BinaryIO

    from depthcli.core.parallel import Background
    from depthcli.core.types import DepthMap
    from depthcli.inference.session import Session
    from depthcli.jobs.image import FailedInput, Target

_RULES = outputs.FormatRules(
    (Format.PNG16, Format.PREVIEW), format_of, stem_of, FILE_SUFFIXES, stdout=Format.PNG16
)


def image_destination(
    output: str | None = None, formats: Sequence[Format] = (), *, sidecar: bool = False
) -> Destination[Format]:
    """Where the outputs of images go, and their formats; raises as :meth:`Destination.parse`."""
    return Destination.parse(output, formats, _RULES, Format.JSON if sidecar else None)


@dataclass(frozen=True, slots=True)
class PredictRequest(MapOptions):
    """Images, and how to process them."""

    images: tuple[str, ...]  #: names of files; ``-`` is ``stdin``
    destination: Destination[Format] = field(default_factory=image_destination)
    model: SessionLoader = field(default_factory=SessionLoader)  #: which model runs, and how
    overwrite: bool = False  #: whether outputs may replace files of other programs
    stdin: BinaryIO | None = None  #: where ``-`` is read; None for that of the process
    stdout: BinaryIO | None = None  #: where ``-`` is written; None for that of the process

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubts about the request as a whole, one line each."""
        anchors = self.anchors
        is_shared = bool(anchors) if isinstance(anchors, tuple) else not anchors.is_by_image
        if len(self.images) == 1 or not is_shared:
            return self.camera.warnings
        text = f"{len(self.images)} images are fitted to one set of points, which is right only "
        advice = "'depthcli batch' takes a folder of {anchors} with a file for each image"
        return (
            *self.camera.warnings,
            errors.Message(f"{text}if neither camera nor scene moved", advice),
        )


class PredictResult(NamedTuple):
    """The result of an input whose outputs are all written."""

    name: str  #: the input, as the user wrote it
    outputs: tuple[str, ...]  #: the files written, ``-`` for standard output
    depth: DepthMap  #: the depth map, of an EXR that of its display window
    provider: str  #: the provider that ran the model
    seconds: float  #: from opening the input to the last output
    warnings: tuple[str, ...]  #: one line each


def predict(request: PredictRequest) -> Iterator[PredictResult | FailedInput]:
    """Predict the depth of images; a bad one does not stop the others.

    Outputs are named and the model starts to load before this returns. The results come in the
    order of the images, which are processed while they are iterated over; ModelError is raised
    then if the model cannot be used, and UsageError if it does not accept a focal length.
    """
    names, destination = request.images, request.destination
    if names.count(STDIO) > 1:
        raise errors.UsageError("'-' is standard input and can be read once", "give it once")
    sources = [None if name == STDIO else path_of(name) for name in names]
    if destination.kind is not Kind.STDOUT:
        plans = outputs.plan_outputs(sources, destination)
    elif len(names) == len(destination.wanted) == 1:
        plans = [OutputPlan(sources[0], dict.fromkeys(destination.wanted, Path(STDIO)))]
    else:
        problem = "standard output takes one input and one format"
        raise errors.UsageError(problem, "name a folder for more", option="out")
    plans = [plan._replace(name=safe_name(n)) for n, plan in zip(names, plans, strict=True)]
    return _results(request, plans, request.model.start())


def _results(
    request: PredictRequest, plans: Sequence[OutputPlan[Format]], loading: Background[Session]
) -> Iterator[PredictResult | FailedInput]:
    # Imported while the model loads.
    from depthcli.inference.pipeline import Pipeline  # noqa: PLC0415
    from depthcli.jobs.image import FailedInput, ImageJob, ImageTask, failure_reason  # noqa: PLC0415

    anchors, points = request.anchors, None
    shared = [] if isinstance(anchors, tuple) or anchors.is_by_image else [path_of(anchors.path)]
    is_by_image = not (isinstance(anchors, tuple) or shared)
    try:
        points = None if is_by_image else request.known_points()
    except errors.InputError as error:
        raise errors.UsageError(error.message, option="anchors") from error
    for name in {name for plan in plans for name in plan.outputs}:
        writer_class(name)
    to_stdout = request.destination.kind is Kind.STDOUT
    inputs = [*shared, *(plan.source for plan in plans if plan.source is not None)]
    guard = Guard.of(inputs, overwrite=request.overwrite)
    for plan in plans:
        try:
            start_s = time.perf_counter()
            guard.check(*() if to_stdout else plan.outputs.values())
            if is_by_image:
                points = request.known_points(plan.source)
            with errors.os_errors_as(errors.InputError, "cannot read standard input"):
                data = None if plan.source else (request.stdin or sys.stdin.buffer).read()
            frame = request.read(plan.source, data)
            targets: Mapping[Format, Target] = plan.outputs
            if to_stdout:
                targets = dict.fromkeys(plan.outputs, request.stdout or sys.stdout.buffer)
            image = ImageTask(frame, request.camera, points, targets)
            session = loading.result()
            done = ImageJob(Pipeline(session, request.detail), request.writing).run(image)
            names = tuple(map(str, plan.outputs.values()))
            seconds = time.perf_counter() - start_s
            warnings = tuple(dict.fromkeys((*session.warnings, *done.warnings)))
            yield PredictResult(plan.name, names, done.depth, session.provider, seconds, warnings)
        except (errors.InputError, errors.OutputError) as error:
            yield FailedInput(plan.name, error)
        except errors.ModelError as error:
            from depthcli.inference.pipeline import check_network  # noqa: PLC0415 - seldom needed

            check_network(error, loading.result())
            yield FailedInput(plan.name, error)
        except Exception as error:
            if not errors.is_out_of_memory(error):
                raise
            yield FailedInput(plan.name, errors.InputError(failure_reason(error)))
    loading.result()  # raises if the model cannot be loaded, even if no image was read


def split_own_outputs(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Inputs, and those to skip because depthcli wrote them; UsageError if it wrote all."""
    written = [name for name in names if name != STDIO and is_own_image(name)]
    others = [name for name in names if name not in written]
    if not others:
        raise errors.UsageError(
            f"{safe_name(written[0])} was written by depthcli",
            "name an image, or use 'depthcli convert' for depth files",
        )
    return others, written
