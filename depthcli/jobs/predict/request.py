"""What ``depthcli predict`` is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.core.camera import Camera
from depthcli.core.choices import MAX_PIXELS, PLAIN, Detail
from depthcli.inference.loading import SessionLoader
from depthcli.io.writers.options import WriterOptions

if TYPE_CHECKING:
    from typing import BinaryIO

    from depthcli.io.writers.formats import Format


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
