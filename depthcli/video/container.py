"""Opening a video with FFmpeg's libraries, with an error of one line."""

import os
import zlib
from pathlib import Path, PurePath
from typing import BinaryIO

import av
from av import logging as av_logging
from av.container import InputContainer
from av.video.stream import VideoStream

from depthcli.errors import DepthcliError, InputError, OutputError
from depthcli.io.listing.folder import EXR_SUFFIX, HEIF_SUFFIXES, PICTURE_SUFFIXES
from depthcli.io.storage.paths import regular_size
from depthcli.video.numbering import pattern_advice, pattern_of


class _Pipe:
    """A stream that FFmpeg uses by callbacks, in which it would ignore a ``KeyboardInterrupt``."""

    _error: type[DepthcliError] = InputError

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._stopped: BaseException | None = None

    def check(self) -> None:
        """Raise the error of an earlier callback, if there was one; the stream is stopped then.

        Raises:
            DepthcliError: it cannot be used.
            BrokenPipeError: its reader has closed it.
        """
        reason = self._stopped
        if isinstance(reason, OSError) and not isinstance(reason, BrokenPipeError):
            raise self._error(f"{self} failed: {reason.strerror or reason}") from reason
        if reason is not None:
            raise reason


class InputPipe(_Pipe):
    """A stream that FFmpeg reads; seekable if the wrapped stream is."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream)
        # Read what is available, so that live video is not delayed.
        self._read = getattr(stream, "read1", stream.read)
        self.seekable, self.seek, self.tell = stream.seekable, stream.seek, stream.tell

    def __str__(self) -> str:
        return "standard input"

    def read(self, size: int) -> bytes:
        """Up to ``size`` bytes; none at the end."""
        try:
            return b"" if self._stopped else bytes(self._read(size))
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
            return b""


class OutputPipe(_Pipe):
    """A stream that FFmpeg writes.

    Attributes:
        suffix: chooses the container, such as ``.mkv``.
    """

    _error = OutputError

    def __init__(self, stream: BinaryIO, suffix: str) -> None:
        super().__init__(stream)
        self.suffix = suffix

    def __str__(self) -> str:
        return "standard output"

    def write(self, data: bytes) -> int:
        """Write and flush all data."""
        try:
            if self._stopped is None:
                self._stream.write(data)
                self._stream.flush()
        except BaseException as reason:  # noqa: BLE001 - raised by check
            self._stopped = reason
        return len(data)


def single_picture_advice(name: str) -> str | None:
    """A text that names the file and what to give instead; None if its suffix is no picture's.

    A GIF counts as a video.
    """
    path = PurePath(name)
    suffix = path.suffix.lower()
    if suffix == ".gif" or suffix not in (*PICTURE_SUFFIXES, *HEIF_SUFFIXES, EXR_SUFFIX):
        return None
    pattern = pattern_of(path.stem)
    folder = name.removesuffix(path.name)
    sequence = f"such as '{folder}{pattern}{path.suffix}'" if pattern else "as a folder of its own"
    return f"{name} is a single picture: use 'depthcli predict', or give its sequence, {sequence}"


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


_MATROSKA = "matroska,webm"
_SLICE_FOOTER_BYTES = 8  # bytes: three of the slice's size, one of its state, four of its checksum
_BIT_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ONES = 0xFFFFFFFF


def has_valid_slices(packet: bytes) -> bool:
    """Whether the checksum of every slice of an FFV1 frame is right (RFC 9043, 4.9.3).

    The frame is of version 3, with checksums. FFmpeg replaces damaged slices with those of the
    frame before, and only logs it.
    """
    end = len(packet)
    while end > 0:
        start = (
            end - _SLICE_FOOTER_BYTES - int.from_bytes(packet[max(0, end - 8) : max(0, end - 5)])
        )
        if start < 0 or _crc(packet[start:end]):
            return False
        end = start
    return bool(packet)


def _crc(data: bytes) -> int:
    """CRC-32 with the most significant bit first and an initial value of 0, bit-reversed."""
    return zlib.crc32(data.translate(_BIT_REVERSED), _ONES) ^ _ONES


def is_incomplete_matroska(path: Path) -> bool:
    """Whether a Matroska or WebM file is truncated or has a gap; False for other containers.

    FFmpeg's demuxer skips such places without an error, and only logs them. The file is read once
    more, without decoding.

    Raises:
        InputError: it is no video any more.
    """
    level, skips = av_logging.get_level(), av_logging.get_skip_repeated()
    av_logging.set_level(av_logging.ERROR)
    av_logging.set_skip_repeated(False)
    try:
        container, stream = open_video(path)
        with container, av_logging.Capture() as log:
            if container.format.name != _MATROSKA:
                return False
            for _ in container.demux(stream):
                pass
    except av.FFmpegError:
        return True
    finally:
        av_logging.set_level(level)
        av_logging.set_skip_repeated(skips)
    return any(name == _MATROSKA for _, name, _ in log)
