"""Predicting the depth of pictures, as ``depthcli predict`` does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.errors import UsageError
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.paths import path_of
from depthcli.jobs.predict.plan import PicturePlan, picture_formats, plan_pictures

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from depthcli.jobs.outputs import FailedInput
    from depthcli.jobs.predict.pictures import PictureResult
    from depthcli.jobs.predict.request import PredictRequest


def predict(request: PredictRequest) -> Iterator[PictureResult | FailedInput]:
    """Predict the depth of pictures; a bad one does not stop the others.

    Outputs are named and the model starts to load before this returns; pictures are processed
    while the result is iterated over.

    Returns:
        An iterator of results, in the order of the pictures. It raises ModelError if the model
        cannot be used, and UsageError if the model does not accept a focal length.

    Raises:
        UsageError: the outputs do not fit the pictures, or collide, or one would replace the known
            depth.
    """
    formats = picture_formats(request.output, request.formats)
    plans = plan_pictures(request.pictures, request.output, formats, sidecar=request.sidecar)
    _check_anchors_stay(plans, request)
    loading = request.model.start()
    # Imported here, while the model loads.
    from depthcli.jobs.predict.pictures import predict_pictures  # noqa: PLC0415

    return predict_pictures(request, plans, loading)


def _check_anchors_stay(plans: Sequence[PicturePlan], request: PredictRequest) -> None:
    if isinstance(request.anchors, tuple):
        return
    known = path_of(request.anchors.path)
    for path in (path for plan in plans for path in plan.outputs.values()):
        if path is not None and is_same_file(path, known):
            raise UsageError(f"{path} is the file of --anchors; choose another -o")
