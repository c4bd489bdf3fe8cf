"""What ``depthcli predict`` does: each picture through the model and into its files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.jobs.predict.plan import picture_formats, plan_pictures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from depthcli.jobs.failed import Failed
    from depthcli.jobs.predict.pictures import Done
    from depthcli.jobs.predict.request import PredictRequest


def predict(request: PredictRequest) -> Iterator[Done | Failed]:
    """Depth of pictures; a bad one never stops the others.

    Outputs are named and the model begins to load before this returns; each picture is read when
    its turn comes.

    Returns:
        An iterator with what became of each picture, in their order. It raises ModelError if the
        model cannot be used, and UsageError if the model takes no focal length.

    Raises:
        UsageError: the outputs do not fit the pictures, or each other.
    """
    formats = picture_formats(request.output, request.formats)
    plans = plan_pictures(request.pictures, request.output, formats, sidecar=request.sidecar)
    loading = request.model.start()
    # What reads pictures is imported while the model loads.
    from depthcli.jobs.predict.pictures import each_picture  # noqa: PLC0415

    return each_picture(request, plans, loading)
