"""What ``depthcli predict`` does: each picture through the model and into its files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.core.camera import Camera
from depthcli.core.choices import MAX_PIXELS, PLAIN, Detail
from depthcli.inference.loading import SessionLoader
from depthcli.io.writers.options import WriterOptions
from depthcli.jobs.predict.plan import picture_formats, plan_pictures

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import BinaryIO

    from depthcli.io.writers.formats import Format
    from depthcli.jobs.failed import Failed
    from depthcli.jobs.predict.pictures import Done


@dataclass(frozen=True, slots=True)
class PredictRequest:
    """Pictures, and what is to become of each.

    Attributes:
        pictures: names of files; ``-`` is ``stdin``.
        output: a file for one picture, a folder (it exists, or ends in ``/``), ``-`` for
            ``stdout``; None for files beside each picture.
        formats: what to write; empty for what the output's suffix says, else PNG and preview.
        sidecar: write the JSON as well.
        model: which model runs, and how.
        camera: what is known of the camera.
        writing: options of the formats.
        detail: how depth becomes that of a full-size picture.
        max_pixels: larger pictures are refused.
        stdin: where ``-`` is read.
        stdout: where ``-`` is written.
    """

    pictures: tuple[str, ...]
    output: str | None = None
    formats: tuple[Format, ...] = ()
    sidecar: bool = False
    model: SessionLoader = field(default_factory=SessionLoader)
    camera: Camera = field(default_factory=Camera)
    writing: WriterOptions = field(default_factory=WriterOptions)
    detail: Detail = PLAIN
    max_pixels: int = MAX_PIXELS
    stdin: BinaryIO | None = None
    stdout: BinaryIO | None = None


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
