"""Requests of the jobs, in one line."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from depthcli.io.formats.table import Format
from depthcli.jobs.predict import PredictRequest, image_destination
from depthcli.jobs.video.plan import VideoRequest, video_destination
from depthcli.video.formats import VideoFormat


def video_request(
    source: Path | str,
    out: Path | str | None = None,
    formats: Sequence[VideoFormat] = (),
    *,
    sidecar: bool = False,
    **more: Any,
) -> VideoRequest:
    """A video and its outputs; further fields of the request as they are."""
    where = video_destination(None if out is None else str(out), formats, sidecar=sidecar)
    return VideoRequest(str(source), where, **more)


def predict_request(
    sources: Sequence[Path | str],
    out: Path | str | None = None,
    formats: Sequence[Format] = (),
    **more: Any,
) -> PredictRequest:
    """Images and their outputs; further fields of the request as they are."""
    where = image_destination(None if out is None else str(out), formats)
    return PredictRequest(tuple(map(str, sources)), where, **more)
