"""How a video becomes depth, whatever its outputs are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.core.camera import Camera
from depthcli.core.choices import MAX_PIXELS, PLAIN, Detail
from depthcli.io.writers.options import WriterOptions
from depthcli.video.spans import WHOLE, Span

if TYPE_CHECKING:
    from fractions import Fraction

LOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """Options that outputs follow from, the same for every video.

    Attributes:
        writing: options of the formats.
        span: which frames.
        smooth_s: time constant of the depth's smoothing in seconds; 0 for none.
        lock_s: time constant of the preview's range; 0 for each frame's own.
        camera: what is known of the camera; points of known depth are for pictures.
        detail: how depth becomes that of a full-size frame.
        max_pixels: videos with larger frames are refused.
        fps: frames a second of an image sequence; None for what it states.
        start_number: of the first frame in names of files; None for its number in the input.
    """

    writing: WriterOptions = field(default_factory=WriterOptions)
    span: Span = WHOLE
    smooth_s: float = 0.0
    lock_s: float = LOCK_S
    camera: Camera = field(default_factory=Camera)
    detail: Detail = PLAIN
    max_pixels: int = MAX_PIXELS
    fps: Fraction | None = None
    start_number: int | None = None
