"""Predicting the depth of pictures, as ``depthcli predict`` does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.jobs.predict.plan import picture_destination, plan_pictures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from depthcli.jobs.predict.pictures import PictureResult
    from depthcli.jobs.predict.request import PredictRequest
    from depthcli.jobs.write import FailedInput


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
    destination = picture_destination(request.output, request.formats, sidecar=request.sidecar)
    plans = plan_pictures(request.pictures, destination)
    loading = request.model.start()
    # Imported here, while the model loads.
    from depthcli.jobs.predict.pictures import predict_pictures  # noqa: PLC0415

    return predict_pictures(request, plans, loading)
