"""The request of ``depthcli video``, the names of its outputs, and its result."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, BinaryIO

from depthcli.errors import InputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format, format_of
from depthcli.io.storage import paths
from depthcli.jobs import outputs
from depthcli.jobs.outputs import STDIO, Destination, Kind, MapOptions
from depthcli.video import container, formats, numbering
from depthcli.video.container import LiveStream
from depthcli.video.formats import SEQUENCES, PreviewCodec, VideoFormat
from depthcli.video.frames import WHOLE, Span, rate_text, time_code_text

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap, Frame
    from depthcli.jobs.video.page import PreviewPage
    from depthcli.video.live_source import LiveCounts

_ON_GRID = 1e-6
_LIVE = "live"
LOCK_S = 1.0
LOOK_AHEAD = 8


@dataclass(frozen=True, slots=True)
class VideoSettings(MapOptions):
    """Options that affect the outputs."""

    span: Span = WHOLE  #: the frames to process
    smooth_s: float = 0.0  #: time constant of the depth's smoothing in seconds; 0 for none
    look_ahead: int = LOOK_AHEAD  #: later frames that smoothing takes into account
    lock_s: float = LOCK_S  #: time constant of the preview's range in seconds; 0 for each frame's
    #: largest distance of known depth from its frame in seconds; None for half a frame
    anchors_within_s: float | None = None
    stream: int | None = None  #: number of the video stream; None for the one with most frames
    fps: Fraction | None = None  #: frames per second of an image sequence; None for what it states
    segment_s: float | None = None  #: length of a file in seconds; None for one file
    start_number: int | None = None  #: of the first frame in file names; None for the input's


def _of_name(name: str) -> VideoFormat | None:
    """The format of a video, or of numbered files, that a file's suffix chooses."""
    format_ = formats.video_format_of(name) or _of_pattern(name)
    return None if format_ is VideoFormat.JSON else format_


def _of_pattern(name: str) -> VideoFormat | None:
    """The format of numbered files that a name's suffix chooses; previews of a video are videos."""
    return None if format_of(name) is Format.PREVIEW else formats.sequence_of(name)


_RULES = outputs.FormatRules(
    (VideoFormat.MKV, VideoFormat.MP4),
    _of_name,
    formats.video_stem_of,
    tuple(which.facts.file_suffix or "" for which in formats.VIDEOS),
    stdout=VideoFormat.MKV,
    of_pattern=_of_pattern,
    is_bare_folder=True,
)


def video_destination(
    output: str | None = None, formats_: Sequence[VideoFormat] = (), *, sidecar: bool = False
) -> Destination[VideoFormat]:
    """Where the outputs of a video go, and their formats.

    The output is a file for one format; a stem, if there are several or the suffix is of no format;
    a folder, which exists, ends in ``/`` or has no suffix; a pattern for numbered files; ``-``; or
    None for the video's own folder. By default, the formats are that of its suffix, else depth and
    a preview. UsageError as of :meth:`Destination.parse`, or if JSON is the only format.
    """
    chosen = [format_ for format_ in formats_ if format_ is not VideoFormat.JSON]
    if formats_ and not chosen:
        raise UsageError("json only describes other outputs", "give another {format} with it")
    json_ = VideoFormat.JSON if sidecar or VideoFormat.JSON in formats_ else None
    return Destination.parse(output, chosen, _RULES, json_)


@dataclass(frozen=True, slots=True)
class VideoRequest:
    """A video, and how to process it."""

    video: str  #: a file, a folder of numbered images, a pattern (``plate.%04d.exr``), or ``-``
    destination: Destination[VideoFormat] = field(default_factory=video_destination)
    codec: PreviewCodec | None = None  #: of the preview; None for the usual one of its container
    has_audio: bool = True  #: include the video's audio in the preview
    #: model, provider and threads; by default, threads per worker are cores / workers
    model: SessionLoader = field(default_factory=SessionLoader)
    #: options that affect the outputs
    settings: VideoSettings = field(default_factory=VideoSettings)
    workers: int | None = None  #: threads besides the one that writes; None for one per core
    overwrite: bool = False  #: whether outputs may replace files of other programs
    stdin: BinaryIO | None = None  #: where ``-`` is read; None for that of the process
    live: LiveStream | None = None  #: the stream that ``video`` names; None for a file
    raw: container.RawVideo | None = None  #: frames without a container in ``-``; None for others
    stdout: BinaryIO | None = None  #: where ``-`` is written; None for that of the process
    page: PreviewPage | None = None  #: shows the newest preview


@dataclass(frozen=True, slots=True)
class VideoPlan:
    """One video and its outputs."""

    name: str  #: the video as the user wrote it
    source: Path | container.InputPipe | LiveStream  #: the file, standard input, or a live stream
    folder: Path  #: folder of the outputs
    names: Mapping[VideoFormat, str]  #: file name of each; ``%06d`` of a sequence, ``-`` for stdout
    request: VideoRequest  #: how to process it
    first_segment: int = 0  #: number of the first file, if they are of a limited length
    sha256: str | None = None  #: of a source that is a temporary copy, which no path identifies

    @property
    def settings(self) -> VideoSettings:
        """Options that affect the outputs."""
        return self.request.settings

    def path(self, format_: VideoFormat, segment: int | None = None) -> Path:
        """The output path of a format, or of one of its segments."""
        name = self.names[format_]
        return self.folder / (name if segment is None else numbering.numbered_name(name, segment))

    def target(
        self, format_: VideoFormat, segment: int | None = None
    ) -> Path | container.OutputPipe:
        """The output path of a format, or of one of its segments, or standard output."""
        if self.request.destination.kind is not Kind.STDOUT:
            return self.path(format_, segment)
        stream = self.request.stdout or sys.stdout.buffer
        return container.OutputPipe(stream, PurePath(format_.facts.suffix).suffix)


@dataclass(frozen=True, slots=True)
class VideoResult:
    """The result of a video whose outputs are all written."""

    plan: VideoPlan  #: the video, and the files written
    numbers: Sequence[int]  #: numbers of the frames written; the first of the file has 0
    times_s: Sequence[float]  #: time of each of them, from the first frame of the video
    rate: Fraction  #: frames per second of the outputs, exact
    source_rate: Fraction  #: frames per second of the video
    first: Frame  #: first frame written, without its pixels
    depth: DepthMap  #: its depth, for kind and model
    flicker: float | None  #: of the depth written; None without two similar frames
    flicker_unsmoothed: float | None  #: flicker before smoothing; None without smoothing
    scenes: int  #: number of scenes
    provider: str  #: the provider that ran the model
    seconds: float  #: from opening the video to the last output
    warnings: tuple[str, ...]  #: one line each
    problem: str | None  #: why frames are missing at the end; None if none are
    live: LiveCounts | None = None  #: frames that came and were dropped; None of a file

    @property
    def name(self) -> str:
        """The video, as the user wrote it."""
        return self.plan.name

    @property
    def outputs(self) -> tuple[str, ...]:
        """The files written; a sequence's with ``%06d`` for the frame's number."""
        return tuple(str(self.plan.path(format_)) for format_ in self.plan.names)

    @property
    def frames(self) -> int:
        """Number of frames written."""
        return len(self.numbers)

    @property
    def is_regular(self) -> bool:
        """Whether the frames have the times of a constant frame rate."""
        start_s, rate = self.times_s[0], self.rate
        return all(abs((t - start_s) * rate - i) < _ON_GRID for i, t in enumerate(self.times_s))

    def metadata(self) -> dict[str, object]:
        """The fields of JSON and sidecar that are the same for every run."""
        from depthcli.io.stored.metadata import known_depth_fields, origin_fields  # noqa: PLC0415 - is loaded by now

        depth = self.depth
        time_code, settings = self.first.time_code, self.plan.settings
        writing = settings.writing
        is_stretched = writing.is_normalized and VideoFormat.PNG16 in self.plan.names
        of_png16: dict[str, object] = {}
        if is_stretched and writing.vmin is not None and writing.vmax is not None:
            ends = {"png16_min": writing.vmin, "png16_max": writing.vmax}
            is_inverse = writing.png_inverse and depth.is_metric
            of_png16 = {"png16_scale": None, "png16_inverse": is_inverse, **ends}
        return {
            "frames": self.frames,
            "fps": rate_text(self.rate),
            "source_fps": rate_text(self.source_rate),
            "constant_rate": self.is_regular,
            "first_frame": self.first.index,
            "start_s": self.first.timestamp_s,
            "time_code": None if time_code is None else time_code_text(time_code, self.source_rate),
            "width": depth.width,
            "height": depth.height,
            "orientation": self.first.orientation,
            "kind": depth.kind.value,
            "unit": depth.unit,
            "scale": writing.units_per_metre if depth.is_metric and not is_stretched else None,
            **of_png16,
            "scenes": self.scenes,
            "flicker": self.flicker,
            "flicker_unsmoothed": self.flicker_unsmoothed,
            "smooth_s": settings.smooth_s,
            "look_ahead": settings.look_ahead,
            "lock_s": settings.lock_s,
            **origin_fields(depth),
            **known_depth_fields(depth),
        }

    def sidecar(self, *, has_times: bool) -> str:
        """The text of the sidecar, the same for every run.

        With ``has_times``, it also states the time of each frame by its number, for numbered files.
        """
        from depthcli.io.stored.metadata import SOFTWARE  # noqa: PLC0415 - is loaded by now

        metadata = {"software": SOFTWARE, **self.metadata()}
        if has_times:
            metadata["times_s"] = dict(zip(self.numbers, self.times_s, strict=True))
        return json.dumps(metadata, indent=2, allow_nan=False) + "\n"


def video_base(source: Path | None) -> str:
    """The name of a video's outputs, without suffix; ``source`` is None for standard input.

    It is ``plate`` for ``plate.%04d.exr``, and for a folder ``plate`` of such images.
    """
    if source is None or not numbering.is_sequence(source):
        return outputs.output_bases([source])[0]
    if source.is_dir():
        return source.resolve().name  # "." has no name
    return outputs.stem(numbering.sequence_name(source.name))


def plan_video(request: VideoRequest) -> VideoPlan:
    """Name every output before anything is read.

    UsageError if a sequence is to go into a pipe, or something else than a video into segments.
    """
    name, destination = request.video, request.destination
    if not name:  # as a path, it would be the working directory
        raise InputError("the input's name is empty; is a variable of the command not set?")
    if name != STDIO and request.raw is not None:
        raise UsageError("frames without a container are read from '-'", option="raw")
    file = None if name == STDIO or request.live is not None else paths.path_of(name)
    if destination.kind is Kind.STDOUT:
        folder, wanted = Path(), destination.wanted
        if len(wanted) > 1 or wanted[0] in SEQUENCES:
            problem = f"'-' takes one of mkv, mp4, webm, mov and stereo, not {' and '.join(wanted)}"
            raise UsageError(problem, "name a folder", option="out")
        names = {wanted[0]: STDIO}
    else:
        base = destination.path or (Path() if file is None else file.parent)
        if destination.kind in {Kind.BESIDE, Kind.FOLDER}:
            base = base / (_LIVE if request.live is not None else video_base(file))
        folder = base.parent
        names = {format_: path.name for format_, path in destination.outputs(base).items()}
    first_segment = 0
    if request.settings.segment_s is not None:
        names, first_segment = _segments(names, folder, request)
    return VideoPlan(
        name=paths.safe_name(name),
        source=file
        or request.live
        or container.InputPipe(request.stdin or sys.stdin.buffer, request.raw),
        folder=folder,
        names=names,
        request=request,
        first_segment=first_segment,
    )


def _segments(
    names: Mapping[VideoFormat, str], folder: Path, request: VideoRequest
) -> tuple[dict[VideoFormat, str], int]:
    """Names of the segments of each video, and the number of the first.

    Those of a stream follow the ones that an earlier run wrote, which cannot be made again.
    """
    videos = [kind for kind in names if kind.facts.shows_image or kind is VideoFormat.MKV]
    if not videos or STDIO in names.values() or isinstance(folder, paths.RemotePath):
        problem = "only video files in a local folder have a limited length"
        raise UsageError(problem, "choose another {out}", option="segment")
    segments = {kind: f"{Path(names[kind]).stem}.%04d{Path(names[kind]).suffix}" for kind in videos}
    files = os.listdir(folder) if request.live and folder.is_dir() else []  # noqa: PTH208 - names
    taken = (numbering.number_in(each, file) for each in segments.values() for file in files)
    first = max((number + 1 for number in taken if number is not None), default=0)
    return {**names, **segments}, first
