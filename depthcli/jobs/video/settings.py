"""How a video becomes depth, whatever its outputs are."""

from dataclasses import dataclass, field
from fractions import Fraction

from depthcli.core.camera import Camera
from depthcli.core.choices import MAX_PIXELS, PLAIN, Detail
from depthcli.io.writers.options import WriterOptions
from depthcli.video.spans import WHOLE, Span

LOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """Options that outputs follow from, the same for every video."""

    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    span: Span = WHOLE  #: which frames
    smooth_s: float = 0.0  #: time constant of the depth's smoothing in seconds; 0 for none
    lock_s: float = LOCK_S  #: time constant of the preview's range; 0 for each frame's own
    #: what is known of the camera; points of known depth are for pictures
    camera: Camera = field(default_factory=Camera)
    detail: Detail = PLAIN  #: how depth becomes that of a full-size frame
    max_pixels: int = MAX_PIXELS  #: videos with larger frames are refused
    fps: Fraction | None = None  #: frames a second of an image sequence; None for what it states
    #: of the first frame in names of files; None for its number in the input
    start_number: int | None = None
