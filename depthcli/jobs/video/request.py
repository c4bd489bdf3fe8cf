"""The request of ``depthcli video``."""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import BinaryIO

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.choices import DEFAULT_DETAIL, MAX_PIXELS, Detail
from depthcli.core.picture_options import AS_STATED, ReadOptions
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import WriterOptions
from depthcli.video.codecs import PreviewCodec
from depthcli.video.formats import VideoFormat
from depthcli.video.spans import WHOLE, Span

LOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """Options that affect the outputs."""

    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    span: Span = WHOLE  #: the frames to process
    smooth_s: float = 0.0  #: time constant of the depth's smoothing in seconds; 0 for none
    #: time constant of the preview's range in seconds; 0 for the range of each frame
    lock_s: float = LOCK_S
    camera: Intrinsics = UNKNOWN_CAMERA  #: what is known of the camera
    reading: ReadOptions = AS_STATED  #: how the images of a sequence are read
    detail: Detail = DEFAULT_DETAIL  #: how depth becomes that of a full-size frame
    max_pixels: int = MAX_PIXELS  #: videos with larger frames are refused
    fps: Fraction | None = None  #: frames per second of an image sequence; None for what it states
    #: number of the first frame in file names; None for its number in the input
    start_number: int | None = None


@dataclass(frozen=True, slots=True)
class VideoRequest:
    """A video, and how to process it."""

    #: a file, a folder of numbered pictures, a pattern such as ``plate.%04d.exr``, or ``-``
    video: str
    #: a file for one format; a stem, if there are several or the suffix is of no format; a folder,
    #: which exists, ends in ``/`` or has no suffix; a pattern for numbered files; ``-``; None for
    #: the video's own folder
    output: str | None = None
    #: formats to write; empty for that of the output's suffix, else depth and a preview
    formats: tuple[VideoFormat, ...] = ()
    sidecar: bool = False  #: write the JSON as well
    codec: PreviewCodec | None = None  #: of the preview; None for the usual one of its container
    has_audio: bool = True  #: include the video's audio in the preview
    #: model, provider and threads; by default, threads per worker are cores / workers
    model: SessionLoader = field(default_factory=SessionLoader)
    #: options that affect the outputs
    settings: VideoSettings = field(default_factory=VideoSettings)
    #: worker threads besides the one that decodes and writes; None for one per core
    workers: int | None = None
    overwrite: bool = False  #: whether outputs may replace files of other programs
    stdin: BinaryIO | None = None  #: where ``-`` is read
    stdout: BinaryIO | None = None  #: where ``-`` is written
