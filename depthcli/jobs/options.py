"""Options of the depth maps of images, which ``predict``, ``batch`` and ``video`` share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.core import options
from depthcli.core.camera import UNKNOWN_CAMERA, Anchor, Intrinsics
from depthcli.io.formats.table import WriterOptions

if TYPE_CHECKING:
    from depthcli.io.depth.anchors import AnchorFiles


@dataclass(frozen=True, slots=True, kw_only=True)
class MapOptions:
    """How images are read, predicted and written."""

    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    camera: Intrinsics = UNKNOWN_CAMERA  #: what is known of the camera
    anchors: AnchorFiles | tuple[Anchor, ...] = ()  #: known depth, or where files have it
    #: how depth is fitted to that; None for the best that the model can
    anchors_fit: options.AnchorsFit | None = None
    reading: options.ReadOptions = options.AS_STATED  #: how images are read
    #: how depth becomes that of a full-size image
    detail: options.UpsamplingOptions = options.DEFAULT_UPSAMPLING
    max_pixels: int = options.MAX_PIXELS  #: larger images are refused
