"""Opening a video with FFmpeg's libraries, with an error of one line."""

import os
from pathlib import Path

import av
from av.container import InputContainer
from av.video.stream import VideoStream

from depthcli.errors import InputError
from depthcli.io.listing.heif import HEIF_SUFFIXES
from depthcli.io.storage.regular import regular_size
from depthcli.video.number_pattern import pattern_advice
from depthcli.video.pipes import InputPipe
from depthcli.video.single_picture import single_picture_advice

# Playlists are excluded, because they name other files and addresses.
_FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,asf,flv,live_flv,ogg,mxf,gxf,"
    "nut,ivf,h264,hevc,av1,obu,m4v,mjpeg,dv,rm,wtv,gif,apng,yuv4mpegpipe,nsv,swf,vc1,dnxhd,dirac"
)
_OPTIONS = {"format_whitelist": _FORMATS, "protocol_whitelist": "file"}


def open_video(source: Path | InputPipe) -> tuple[InputContainer, VideoStream]:
    """A file or a pipe and its video stream, ready for the first packet.

    Raises:
        InputError: missing, empty, unreadable, or without a video stream that can be decoded.
    """
    file: InputPipe | str
    if isinstance(source, InputPipe):
        file = source
    else:
        _check_file(source)
        if source.suffix.lower() in HEIF_SUFFIXES:  # FFmpeg would take its first tile for a video
            raise InputError(single_picture_advice(str(source)) or "")
        # FFmpeg does not take an absolute path for a protocol.
        file = os.path.abspath(source)  # noqa: PTH100 - links stay as named
    container = None
    try:
        container = av.open(file, "r", options=_OPTIONS, metadata_errors="replace")
        stream = next((s for s in container.streams.video if not _is_cover(s)), None)
        if stream is not None and stream.codec_context is not None:
            stream.thread_type = "AUTO"
            return container, stream
    except (av.FFmpegError, ValueError):
        pass  # reported below
    if container is not None:
        container.close()
    if isinstance(source, InputPipe):
        source.check()
    elif advice := single_picture_advice(str(source)):
        raise InputError(advice)
    raise InputError(
        f"{source} holds no video that can be read: damaged, cut off, without a video stream, "
        "or of a codec that FFmpeg does not have here",
        pipe_advice(source),
    )


def pipe_advice(source: Path | InputPipe) -> str:
    """Advice for a pipe that cannot be read; empty for a file."""
    if not isinstance(source, InputPipe):
        return ""
    return "through a pipe, send Matroska, MPEG-TS, NUT or Y4M: most MP4 files have to be files"


def _is_cover(stream: VideoStream) -> bool:
    """Whether a stream is the cover of an audio file."""
    return bool(stream.disposition & av.stream.Disposition.attached_pic)


def _check_file(path: Path) -> None:
    """Check a file, for clearer errors than FFmpeg's."""
    try:
        size = regular_size(path)
        with path.open("rb"):  # not read: files such as /proc/kmsg state no size and never end
            pass
    except FileNotFoundError:
        raise InputError(f"{path} is missing: no such file", pattern_advice(path.name)) from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    if not size:
        raise InputError(f"{path} is empty")
