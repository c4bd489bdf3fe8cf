"""The output files of ``depthcli video``."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path, PurePath
from typing import BinaryIO

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.options import AS_STATED, DEFAULT_DETAIL, MAX_PIXELS, Detail, ReadOptions
from depthcli.errors import InputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format, WriterOptions, format_of
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.paths import RemotePath, check_writable, path_of, safe_name
from depthcli.jobs.naming import is_folder, output_bases
from depthcli.jobs.unique_names import comparable, names_near
from depthcli.video.container import InputPipe, OutputPipe
from depthcli.video.formats import (
    SEQUENCES,
    VIDEO_FORMATS,
    Codec,
    PreviewCodec,
    VideoFormat,
    frame_suffix,
    preview_codec,
    sequence_of,
    video_format_of,
    video_stem_of,
)
from depthcli.video.frames import WHOLE, Span
from depthcli.video.numbering import (
    base_name,
    check_folders,
    is_pattern,
    number_in,
    pattern_of,
    sequence_name,
)
from depthcli.video.sequence import is_sequence_picture, listed_names
from depthcli.video.source import is_sequence

STDIO = "-"
DEFAULT_FORMATS = (VideoFormat.MKV, VideoFormat.MP4)


def video_formats(output: str | None, asked: Sequence[VideoFormat]) -> tuple[VideoFormat, ...]:
    """The formats to write: the requested ones, else that of the output's suffix, else the default.

    Raises:
        UsageError: the output is empty, or a file whose suffix is of no format, or JSON is the only
            format.
    """
    if output == "":
        raise UsageError("-o is empty; name a file or a folder, or omit -o")
    if output is not None and is_pattern(path_of(output).name) and not is_folder(output):
        chosen: tuple[VideoFormat, ...] = (_format_of_pattern(output, asked),)
    elif asked:
        chosen = tuple(dict.fromkeys(asked))
    elif output == STDIO:
        chosen = (VideoFormat.MKV,)
    elif output is None or is_output_folder(output):
        chosen = DEFAULT_FORMATS
    elif (found := video_format_of(output) or _sequence_named(output)) is not None:
        chosen = (found,)
    else:
        raise UsageError(
            f"--out {safe_name(output)} has no suffix that selects a format; use .mkv, .mp4, .webm "
            f"or .mov, give --format, or end the name in '/' for a folder"
        )
    if set(chosen) == {VideoFormat.JSON}:
        raise UsageError("json only describes other outputs; give another --format with it")
    return chosen


def is_output_folder(output: str) -> bool:
    """Whether ``--out`` names a folder: it exists as one, ends in a separator, or has no suffix."""
    return is_folder(output) or not path_of(output).suffix


def file_names(
    output: Path, formats: Sequence[VideoFormat], wanted: Sequence[VideoFormat]
) -> dict[VideoFormat, str]:
    """File names for an output that is no folder: a pattern, one file, or the stem of the names.

    A name without the suffix of a format is a stem, also of a single file.

    Args:
        output: the path.
        formats: what is to be written.
        wanted: the same, and JSON if a sidecar is.

    Raises:
        UsageError: the suffix is of another format, or the format is one file per frame.
    """
    main = [which for which in formats if which is not VideoFormat.JSON]
    if is_pattern(output.name):
        names: dict[VideoFormat, str] = {main[0]: output.name}
        sidecar = base_name(output.stem)
    elif len(main) == 1 and (video_format_of(output) or format_of(output)):
        _check_suffix(output, main[0])
        names, sidecar = {main[0]: output.name}, output.stem
    else:
        stem = video_stem_of(output)
        return {which: stem + VIDEO_FORMATS[which].suffix for which in wanted}
    return names | ({VideoFormat.JSON: f"{sidecar}.json"} if VideoFormat.JSON in wanted else {})


def _check_suffix(output: Path, which: VideoFormat) -> None:
    if which in SEQUENCES:
        name = output.with_name(f"{output.stem}.%04d{frame_suffix(which)}")
        raise UsageError(
            f"--out {output} is one file and {which} writes one per frame; give --out {name}, or "
            "name a folder"
        )
    if video_format_of(output) is not which:
        raise UsageError(
            f"--out {output} does not end in .{which}; the suffix has to match the format"
        )


def _format_of_pattern(output: str, asked: Sequence[VideoFormat]) -> VideoFormat:
    """The format of the files of a pattern such as ``depth.%04d.exr``."""
    check_folders(path_of(output))
    found = _sequence_named(output)
    if found is None or set(asked) - {found}:
        raise UsageError(
            f"--out {output} is a pattern for numbered files: end it in .png, .exr or .npy, with "
            "no other --format"
        )
    return found


def _sequence_named(output: str) -> VideoFormat | None:
    """The format of numbered files that a name's suffix chooses; None if it chooses none."""
    if format_of(output) is Format.PREVIEW:
        raise UsageError(
            f"--out {safe_name(output)} is the name of a preview, and previews of a video are "
            "videos; name a .mp4, .webm or .mov file"
        )
    return sequence_of(output)


def video_base(source: Path | None) -> str:
    """The name of a video's outputs, without suffix; ``source`` is None for standard input.

    An image sequence counts as one file, ``plate.exr`` for ``plate.%04d.exr`` and for a folder
    ``plate`` of such pictures. As of any file, its suffix is kept if another input of its folder
    has its stem. A checksum follows if another sequence has this suffix, too.
    """
    if source is None:
        return output_bases([None])[0]
    source, name = _as_one_file(source)
    (base,) = output_bases([source.with_name(name)])
    others = {comparable(other) for other in _sequences(source, name)}
    if comparable(name) in others:
        return f"{name}.{hashlib.sha256(os.fsencode(source.name)).hexdigest()[:8]}"
    return name if others and base == PurePath(name).stem else base


def _as_one_file(source: Path) -> tuple[Path, str]:
    """The input, and the name of the one file that it counts as."""
    if not is_sequence(source):
        return source, source.name
    if source.is_dir():
        source = source.resolve()  # "." has no name
        with suppress(OSError):  # which reading it reports
            return source, source.name + _picture_suffix(source)
    return source, sequence_name(source.name)


def _sequences(source: Path, name: str) -> list[str]:
    """The other sequences in the folder of an input that count as files with the stem of a name."""
    folder, stem = source.parent, PurePath(name).stem
    firsts: dict[str, str] = {}
    try:
        for one in sorted(filter(is_sequence_picture, names_near(folder, [name]))):
            pattern = pattern_of(PurePath(one).stem)
            if pattern is not None and number_in(source.name, one) is None:
                other = sequence_name(pattern + PurePath(one).suffix)
                firsts.setdefault(other, one)
        suffix = "" if source.name == stem else _picture_suffix(folder / stem)
    except OSError:  # what cannot be listed has no sequence that can be read
        return []
    found = [
        other
        for other, first in firsts.items()
        if comparable(PurePath(other).stem) == comparable(stem)
        and not is_own_picture(folder / first)
    ]
    return [*found, stem + suffix] if suffix else found


def _picture_suffix(folder: Path) -> str:
    """The suffix of the first picture in a folder; empty without one, or if depthcli wrote it.

    Raises:
        OSError: the folder cannot be listed.
    """
    names = listed_names(folder) if folder.is_dir() else ()
    first = next(filter(is_sequence_picture, names), None)
    return "" if first is None or is_own_picture(folder / first) else PurePath(first).suffix


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


@dataclass(frozen=True, slots=True)
class VideoPlan:
    """One video and its outputs."""

    name: str  #: the video as the user wrote it
    source: Path | InputPipe  #: the file, or standard input
    folder: Path  #: folder of the outputs
    #: file name of each format; that of a sequence is a pattern such as ``%06d``, and ``-`` is
    #: standard output
    names: Mapping[VideoFormat, str]
    codecs: Mapping[VideoFormat, Codec] = field(default_factory=dict)  #: of the previews
    has_audio: bool = True  #: whether previews include the audio
    stdout: BinaryIO | None = None  #: the stream for ``-``
    overwrite: bool = False  #: whether outputs may replace files of other programs
    #: SHA-256 of a source that is a temporary copy, which its path and its time do not identify
    sha256: str | None = None

    def path(self, which: VideoFormat) -> Path:
        """The output path of a format."""
        return self.folder / self.names[which]

    def target(self, which: VideoFormat) -> Path | OutputPipe:
        """The output path of a format, or standard output."""
        if self.stdout is None:
            return self.path(which)
        return OutputPipe(self.stdout, VIDEO_FORMATS[which].file_suffix or "")


def plan_video(request: VideoRequest) -> VideoPlan:
    """Name every output before anything is read.

    Raises:
        InputError: the video's name is empty.
        UsageError: the output is empty, its suffix is of no format, a sequence is to go into one
            file or a pipe, an output is the video itself, or a codec is for another container.
    """
    name, output = request.video, request.output
    if not name:  # as a path, it would be the working directory
        raise InputError("the input's name is empty; is a variable of the command not set?")
    formats = video_formats(output, request.formats)
    source, file = _source(name, request.stdin), None if name == STDIO else path_of(name)
    wanted = tuple(dict.fromkeys([*formats, VideoFormat.JSON] if request.sidecar else formats))
    if output == STDIO:
        folder, names = Path(), _stdout_name(wanted, request.stdout)
    elif output is None or is_output_folder(output):
        folder = path_of(name).parent if output is None else path_of(output)
        base = video_base(file)
        names = {which: base + VIDEO_FORMATS[which].suffix for which in wanted}
    else:
        folder = path_of(output).parent
        names = file_names(path_of(output), formats, wanted)
    asked = None if request.codec is None else Codec(request.codec)
    previews = [which for which in names if VIDEO_FORMATS[which].is_preview]
    codecs = {which: preview_codec(f".{which}", asked) for which in previews}
    stdout = request.stdout if output == STDIO else None
    plan = VideoPlan(
        safe_name(name),
        source,
        folder,
        names,
        codecs,
        request.has_audio,
        stdout,
        request.overwrite,
    )
    for which in names:
        check_writable(plan.path(which))
        if _is_the_video(plan.path(which), file, request.stdin):
            raise UsageError(f"{plan.path(which)} is the input; choose another --out")
    return plan


def _is_the_video(path: Path, file: Path | None, stdin: BinaryIO | None) -> bool:
    """Whether an output is the video, also if standard input is redirected from it."""
    if file is not None:
        return is_same_file(path, file)
    if stdin is None or isinstance(path, RemotePath):
        return False
    try:
        return os.path.samestat(os.fstat(stdin.fileno()), path.stat())
    except (OSError, ValueError):  # no such file yet, or a stream without a file
        return False


def _source(name: str, stdin: BinaryIO | None) -> Path | InputPipe:
    if name != STDIO:
        return path_of(name)
    if stdin is None:
        raise UsageError("the input is '-' but there is no stdin; name a file")
    return InputPipe(stdin)


def _stdout_name(wanted: Sequence[VideoFormat], stdout: BinaryIO | None) -> dict[VideoFormat, str]:
    if len(wanted) > 1 or wanted[0] in SEQUENCES:
        raise UsageError(
            f"-o - takes one of mkv, mp4, webm and mov, not {' and '.join(wanted)}; name a folder"
        )
    if stdout is None:
        raise UsageError("the output is '-' but there is no stdout; name a file or a folder")
    return {wanted[0]: STDIO}
