"""Predicting the depth of pictures, as ``depthcli predict`` does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.jobs.predict.plan import picture_formats, plan_pictures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from depthcli.jobs.failed import FailedInput
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
        UsageError: the outputs do not fit the pictures, or collide.
    """
    formats = picture_formats(request.output, request.formats)
    plans = plan_pictures(request.pictures, request.output, formats, sidecar=request.sidecar)
    loading = request.model.start()
    # Imported here, while the model loads.
    from depthcli.jobs.predict.pictures import predict_pictures  # noqa: PLC0415

    return predict_pictures(request, plans, loading)
