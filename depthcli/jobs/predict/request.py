"""The request of ``depthcli predict``; free of numpy, which loads while the model does."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

from depthcli.core.camera import UNKNOWN_CAMERA, Anchor, Intrinsics
from depthcli.core.options import AS_STATED, DEFAULT_DETAIL, MAX_PIXELS, Detail, ReadOptions
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format, WriterOptions

if TYPE_CHECKING:
    from depthcli.io.depth.anchors import AnchorFiles


@dataclass(frozen=True, slots=True)
class PredictRequest:
    """Pictures, and how to process them."""

    pictures: tuple[str, ...]  #: names of files; ``-`` is ``stdin``
    #: a file for one picture, a folder (it exists, or ends in ``/``), ``-`` for ``stdout``; None
    #: for files beside each picture
    output: str | None = None
    #: formats to write; empty for that of the output's suffix, else PNG and preview
    formats: tuple[Format, ...] = ()
    sidecar: bool = False  #: write the JSON as well
    model: SessionLoader = field(default_factory=SessionLoader)  #: which model runs, and how
    camera: Intrinsics = UNKNOWN_CAMERA  #: what is known of the camera
    #: points of known depth, or a file of them for all images
    anchors: AnchorFiles | tuple[Anchor, ...] = ()
    reading: ReadOptions = AS_STATED  #: how images are read
    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    detail: Detail = DEFAULT_DETAIL  #: how depth becomes that of a full-size picture
    max_pixels: int = MAX_PIXELS  #: larger pictures are refused
    overwrite: bool = False  #: whether outputs may replace files of other programs
    stdin: BinaryIO | None = None  #: where ``-`` is read
    stdout: BinaryIO | None = None  #: where ``-`` is written
