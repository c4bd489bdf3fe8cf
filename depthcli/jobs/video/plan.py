"""The output files of ``depthcli video``."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from depthcli.errors import InputError, UsageError
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.remote import RemotePath, check_writable, path_of, safe_name
from depthcli.jobs.video.base_names import video_base
from depthcli.jobs.video.output_names import STDIO, file_names, is_output_folder, video_formats
from depthcli.jobs.video.request import VideoRequest
from depthcli.video.codecs import Codec, preview_codec
from depthcli.video.formats import SEQUENCES, VIDEO_FORMATS, VideoFormat
from depthcli.video.pipes import InputPipe, OutputPipe


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
