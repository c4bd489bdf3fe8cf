"""Predicting the depth of images, as ``depthcli predict`` does; free of numpy until a model loads.

What needs numpy is in :mod:`depthcli.jobs.predict_images`, imported while the model loads.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.errors import Message, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import FILE_SUFFIXES, Format, format_of, stem_of
from depthcli.io.guard import is_own_image
from depthcli.io.storage.paths import path_of, safe_name
from depthcli.jobs import outputs
from depthcli.jobs.outputs import STDIO, Destination, Kind, MapOptions, OutputPlan

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import BinaryIO

    from depthcli.jobs.image import FailedInput
    from depthcli.jobs.predict_images import PredictResult

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
            Message(f"{text}if neither camera nor scene moved", advice),
        )


def predict(request: PredictRequest) -> Iterator[PredictResult | FailedInput]:
    """Predict the depth of images; a bad one does not stop the others.

    Outputs are named and the model starts to load before this returns. The results come in the
    order of the images, which are processed while they are iterated over; ModelError is raised
    then if the model cannot be used, and UsageError if it does not accept a focal length.
    """
    names, destination = request.images, request.destination
    if names.count(STDIO) > 1:
        raise UsageError("'-' is standard input and can be read once", "give it once")
    sources = [None if name == STDIO else path_of(name) for name in names]
    if destination.kind is not Kind.STDOUT:
        plans = outputs.plan_outputs(sources, destination)
    elif len(names) == len(destination.wanted) == 1:
        plans = [OutputPlan(sources[0], dict.fromkeys(destination.wanted, Path(STDIO)))]
    else:
        problem = "standard output takes one input and one format"
        raise UsageError(problem, "name a folder for more", option="out")
    plans = [plan._replace(name=safe_name(n)) for n, plan in zip(names, plans, strict=True)]
    loading = request.model.start()
    from depthcli.jobs.predict_images import predict_images  # noqa: PLC0415 - while it loads

    to_stdout = destination.kind is Kind.STDOUT
    stdout = request.stdout or sys.stdout.buffer if to_stdout else None
    streams = {"stdin": request.stdin, "stdout": stdout}
    return predict_images(request, plans, loading, overwrite=request.overwrite, **streams)


def split_own_outputs(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Inputs, and those to skip because depthcli wrote them; UsageError if it wrote all."""
    written = [name for name in names if name != STDIO and is_own_image(name)]
    others = [name for name in names if name not in written]
    if not others:
        raise UsageError(
            f"{safe_name(written[0])} was written by depthcli",
            "name an image, or use 'depthcli convert' for depth files",
        )
    return others, written
