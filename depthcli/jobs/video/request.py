"""What ``depthcli video`` is asked for."""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import BinaryIO

from depthcli.core.camera import Camera
from depthcli.core.choices import MAX_PIXELS, PLAIN, Detail
from depthcli.inference.loading import SessionLoader
from depthcli.io.writers.options import WriterOptions
from depthcli.video.codecs import PreviewCodec
from depthcli.video.formats import VideoFormat
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


@dataclass(frozen=True, slots=True)
class VideoRequest:
    """A video, and what is to become of it."""

    #: a file, a folder of numbered pictures, a pattern such as ``plate.%04d.exr``, or ``-``
    video: str
    #: a file for one format, or a stem that several share; a folder, which exists, ends in ``/`` or
    #: has no suffix; a pattern for numbered files; ``-``; None for the video's own folder
    output: str | None = None
    #: what to write; empty for what the output's suffix says, else depth and a preview
    formats: tuple[VideoFormat, ...] = ()
    sidecar: bool = False  #: write the JSON as well
    codec: PreviewCodec | None = None  #: of the preview; None for the usual one of its container
    has_sound: bool = True  #: take the video's sound into the preview
    #: which model runs, and how; without a number of threads, with each worker's share of the cores
    model: SessionLoader = field(default_factory=SessionLoader)
    #: how frames become depth, and which do
    settings: VideoSettings = field(default_factory=VideoSettings)
    #: threads beside the one that decodes and writes; None for one a core
    workers: int | None = None
    stdin: BinaryIO | None = None  #: where ``-`` is read
    stdout: BinaryIO | None = None  #: where ``-`` is written
