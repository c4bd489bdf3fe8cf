"""Checking that a video file is complete, by what its container states and by checksums."""

import zlib
from pathlib import Path

import av
from av import logging as av_logging

from depthcli.video.container import open_video
from depthcli.video.pipes import InputPipe
from depthcli.video.truncation import HEAD_BYTES, ends_within_packet, is_truncated

EBML = b"\x1aE\xdf\xa3"
"""The first bytes of every Matroska and WebM."""
_SEGMENT = b"\x18S\x80g"
_CHECKED_BY_DEMUXING = (b"OggS", b"\x30\x26\xb2\x75")
_SLICE_FOOTER_BYTES = 8  # bytes: three of the slice's size, one of its state, four of its checksum
_BIT_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ONES = 0xFFFFFFFF


def is_incomplete(source: Path | InputPipe) -> bool:
    """Whether a part of a file, or of a pipe that was read, is missing, as its container tells.

    Files of Matroska, Ogg and WMV are read once more, without decoding.

    Raises:
        OSError: it cannot be read.
        InputError: it is no video any more.
    """
    if isinstance(source, InputPipe):
        head, end = source.head, source.end
        return matroska_end(head) > end or ends_within_packet(head, end)
    path = source
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        if is_truncated(file, head):
            return True
    if head.startswith(EBML) and matroska_end(head) > path.stat().st_size:
        return True
    return head.startswith((EBML, *_CHECKED_BY_DEMUXING)) and _has_demuxing_errors(path)


def matroska_end(head: bytes) -> int:
    """The size that Matroska or WebM states, by its first bytes; 0 if it states none."""
    before, _, segment = head.partition(_SEGMENT)
    if not (before.startswith(EBML) and segment):
        return 0
    length = 9 - segment[0].bit_length()  # of the number, by its leading zeros
    unknown = (1 << 7 * length) - 1
    size = int.from_bytes(segment[:length]) & unknown
    return 0 if size == unknown else len(before) + len(_SEGMENT) + length + size


def states_frame_count(path: Path) -> bool:
    """Whether a file states the number of frames that can be decoded.

    AVI does. In MP4, an edit list may hide some, but its boxes tell whether it is complete.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return file.read(4) == b"RIFF"


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


def _has_demuxing_errors(path: Path) -> bool:
    """Whether the demuxer logs errors; it skips damaged parts without raising one."""
    level, skips = av_logging.get_level(), av_logging.get_skip_repeated()
    av_logging.set_level(av_logging.ERROR)
    av_logging.set_skip_repeated(False)
    try:
        with av_logging.Capture() as log:
            container, stream = open_video(path)
            with container:
                for _ in container.demux(stream):
                    pass
    except av.FFmpegError:
        return True
    finally:
        av_logging.set_level(level)
        av_logging.set_skip_repeated(skips)
    return any(name == container.format.name for _, name, _ in log)
