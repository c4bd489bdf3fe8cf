"""What ``depthcli video`` is asked for."""

from dataclasses import dataclass, field
from typing import BinaryIO

from depthcli.inference.loading import SessionLoader
from depthcli.jobs.video.settings import VideoSettings
from depthcli.video.codecs import PreviewCodec
from depthcli.video.formats import VideoFormat


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
