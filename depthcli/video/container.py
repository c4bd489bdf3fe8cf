"""Opening a video with FFmpeg's libraries, with an error of one line; names of live streams."""

from __future__ import annotations

import os
import re
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from depthcli.errors import DepthcliError, InputError, OutputError, UsageError, os_errors_as
from depthcli.io.media import EXR_SUFFIX, HEIF_SUFFIXES, IMAGE_SUFFIXES
from depthcli.io.storage.paths import read_bytes, regular_size, safe_name

if TYPE_CHECKING:
    from fractions import Fraction

    from av.container import InputContainer
    from av.video.stream import VideoStream

# Playlists are excluded, because they name other files and addresses.
_FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpeg,mpegts,mpegvideo,asf,flv,live_flv,ogg,mxf,gxf,"
    "nut,ivf,h264,hevc,av1,obu,m4v,mjpeg,jpeg_pipe,mpjpeg,dv,rm,wtv,gif,apng,yuv4mpegpipe,nsv,swf,vc1,dnxhd,dirac"
)
STREAMED_FORMATS = f"{_FORMATS},hls,rtsp,aac"  #: of an address that the user named
_LENGTH = re.compile(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)", re.ASCII)
_STILLS = {*IMAGE_SUFFIXES, *HEIF_SUFFIXES, EXR_SUFFIX} - {".gif"}
_ANIMATED = (".avif", ".png")  #: images that FFmpeg may read as a video; of HEIC it reads a tile
_OPTIONS = {"format_whitelist": _FORMATS, "protocol_whitelist": "file"}


class _Pipe:
    """A stream that FFmpeg uses by callbacks, in which it would ignore a ``KeyboardInterrupt``."""

    def __init__(self, stream: BinaryIO, name: str, error: type[DepthcliError]) -> None:
        self._stream, self._name, self._error = stream, name, error
        self._stopped: BaseException | None = None

    def __str__(self) -> str:
        return self._name

    def check(self) -> None:
        """Raise the error of an earlier callback, if there was one; the stream is stopped then."""
        reason = self._stopped
        if isinstance(reason, OSError) and not isinstance(reason, BrokenPipeError):
            raise self._error(f"{self} failed: {reason.strerror or reason}") from reason
        if reason is not None:
            raise reason


@dataclass(frozen=True, slots=True)
class RawVideo:
    """Frames that follow each other without any header, as programs pipe them."""

    width: int  #: columns of each
    height: int  #: rows of each
    pixel_format: str  #: FFmpeg's name, such as ``bgr24``
    rate: Fraction  #: frames a second


class InputPipe(_Pipe):
    """A stream that FFmpeg reads; seekable if the wrapped stream is."""

    def __init__(self, stream: BinaryIO, raw: RawVideo | None = None) -> None:
        """Wrap a stream, of a container or of frames as ``raw`` states."""
        super().__init__(stream, "standard input", InputError)
        self.raw = raw
        # Read what is available, so that live video is not delayed.
        self._read = getattr(stream, "read1", stream.read)
        self.seekable, self.seek, self.tell = stream.seekable, stream.seek, stream.tell

    def read(self, size: int) -> bytes:
        """Up to ``size`` bytes; none at the end."""
        try:
            return b"" if self._stopped else bytes(self._read(size))
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
            return b""


class OutputPipe(_Pipe):
    """A stream that FFmpeg writes; its suffix chooses the container, such as ``.mkv``."""

    def __init__(self, stream: BinaryIO, suffix: str) -> None:
        super().__init__(stream, "standard output", OutputError)
        self.suffix = suffix

    def write(self, data: bytes) -> int:
        """Write and flush all data."""
        try:
            if self._stopped is None:
                self._stream.write(data)
                self._stream.flush()
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
        return len(data)


def open_video(
    source: Path | InputPipe, stream_number: int | None = None
) -> tuple[InputContainer, VideoStream]:
    """A file or a pipe and its video stream, ready for the first packet.

    ``stream_number`` is among its video streams, from 0; None for the one with most frames, which
    is the first one if that is not stated. InputError if there is none that can be decoded.
    """
    import av  # noqa: PLC0415 - naming outputs does not need it

    name, options = None, _OPTIONS
    errors: Any = {"metadata_errors": "replace"} if av.__version__ < "19" else {}  # if not UTF-8
    if isinstance(source, InputPipe) and (raw := source.raw) is not None:
        name, size = "rawvideo", {"video_size": f"{raw.width}x{raw.height}"}
        options = size | {"pixel_format": raw.pixel_format, "framerate": f"{raw.rate}"}
    # FFmpeg does not take an absolute path for a protocol.
    file = source if isinstance(source, InputPipe) else os.path.abspath(source)  # noqa: PTH100 - links stay as named
    is_image = not isinstance(source, InputPipe) and source.suffix.lower() in _STILLS
    container = None
    try:
        with os_errors_as(InputError, f"{source} cannot be read"):
            if not isinstance(source, InputPipe):
                regular_size(source)
            container = av.open(file, "r", format=name, options=options, **errors)
        streams = video_streams(container)
        if stream_number is not None and stream_number >= len(streams):
            raise UsageError(f"{source} has {len(streams)} video streams", option="stream")
        stream = streams[stream_number] if stream_number is not None else _longest(streams)
        is_still = is_image and not str(file).lower().endswith(_ANIMATED)
        if stream is not None and stream.codec_context is not None and not is_still:
            # Frame threads fill in damage by whatever memory holds, differently in each run.
            stream.thread_type = "SLICE"
            return container, stream
    except (av.FFmpegError, ValueError):
        pass  # reported below
    if container is not None:
        container.close()
    if isinstance(source, InputPipe):
        source.check()
    elif is_image:
        if b"ANMF" in read_bytes(source, first=4096):
            advice = "convert it, for example with 'magick a.webp a.gif'"
            raise InputError(f"{source} is an animated WebP, which FFmpeg cannot read", advice)
        advice = "or give its sequence as a folder or a pattern such as a.%04d.png"
        raise InputError(f"{source} is a single image", f"use 'depthcli predict', {advice}")
    raise InputError(
        f"{source} holds no video that can be read: damaged, cut off, without a video stream, "
        "or of a codec that FFmpeg does not have here",
        pipe_advice(source),
    )


def video_streams(container: InputContainer) -> list[VideoStream]:
    """The video streams of a file, without the covers of audio files."""
    covers = 1 << 10  # AV_DISPOSITION_ATTACHED_PIC
    return [s for s in container.streams.video if not s.disposition & covers]


def _longest(streams: list[VideoStream]) -> VideoStream | None:
    """The stream with most frames, of which still images have one; the first of equals."""

    def frames(stream: VideoStream) -> float:
        length_s = float((stream.duration or 0) * (stream.time_base or 0))
        if duration := _LENGTH.fullmatch(stream.metadata.get("DURATION", "")):  # Matroska
            length_s = (int(duration[1]) * 60 + int(duration[2])) * 60 + float(duration[3])
        return stream.frames or length_s * float(stream.average_rate or 0)

    return max(streams, key=frames, default=None)


def pipe_advice(source: Path | InputPipe) -> str:
    """Advice for a pipe that cannot be read; empty for a file."""
    if not isinstance(source, InputPipe):
        return ""
    if source.raw is not None:
        return "size or pixel format of {raw} are others than those of the frames that came"
    return "through a pipe, send Matroska, MPEG-TS, NUT or Y4M: most MP4 files have to be files"


_ADDRESS = re.compile(r"(?i)(rtsps?|https?)://")
_PLAYLIST = re.compile(r"(?i)https?://[^?#]*\.m3u8([?#]|$)")
_DEVICE = re.compile(r"/dev/video\d+", re.ASCII)
_CAMERA_FORMATS = {"linux": "v4l2", "darwin": "avfoundation"}


@dataclass(frozen=True, slots=True)
class LiveStream:
    """A camera, an address or a pipe, which is read until it is stopped."""

    address: str  #: what FFmpeg opens: an address, or a camera's device
    device_format: str | None = None  #: FFmpeg's reader of cameras; None for an address
    stop: threading.Event = field(default_factory=threading.Event)  #: ends the frames once set
    say: Callable[[str], object] = str  #: told, in another thread, when it is lost and found again
    pipe: InputPipe | None = None  #: standard input, which is read instead; None for others

    def __str__(self) -> str:
        return safe_name(self.address)


def live_stream(
    name: str,
    *,
    is_live: bool = False,
    raw: RawVideo | None = None,
    say: Callable[[str], object] = str,
) -> LiveStream | None:
    """The stream that an input's name stands for; None for a file.

    That is a camera by its number or device, and an address of RTSP or an HLS playlist; with
    ``is_live``, standard input (``-``, of frames as ``raw`` states) and any address of HTTP, which
    are files otherwise. UsageError if a file is to be live.
    """
    if name == "-" and is_live:
        # Unbuffered, as a thread that waits for a buffer would keep the process from ending.
        pipe = InputPipe(getattr(sys.stdin.buffer, "raw", sys.stdin.buffer), raw)
        return LiveStream(str(pipe), say=say, pipe=pipe)
    is_camera = _DEVICE.fullmatch(name) or (name.isdecimal() and not Path(name).exists())
    if is_camera:
        reader = _CAMERA_FORMATS.get(sys.platform)
        device = f"/dev/video{name}" if name.isdecimal() and reader == "v4l2" else name
        return LiveStream(device, reader, say=say)
    if _PLAYLIST.match(name) or (_ADDRESS.match(name) and (is_live or name[:4].lower() == "rtsp")):
        return LiveStream(name, say=say)
    if is_live:
        raise UsageError(f"{safe_name(name)} is no camera, address or pipe", option="live")
    return None
