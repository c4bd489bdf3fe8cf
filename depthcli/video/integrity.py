"""Whether a video file is whole, by what it states and by the checksums that it holds."""

import zlib
from pathlib import Path

import av
from av import logging as av_logging

from depthcli.video.container import open_video
from depthcli.video.endings import ends_early
from depthcli.video.pipes import HEAD_BYTES

_EBML = b"\x1aE\xdf\xa3"
_SEGMENT = b"\x18S\x80g"
_OTHERS_WITH_GAPS = (b"OggS", b"\x30\x26\xb2\x75")
_SLICE_END = 8  # bytes: three of the slice's size, one of its state, four of its checksum
_MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ONES = 0xFFFFFFFF


def is_cut(path: Path) -> bool:
    """Whether an end or a part is missing, by what the container says, if it says that.

    Matroska, Ogg and WMV are read once more, without decoding.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        file.seek(0)
        if ends_early(file):
            return True
    if head.startswith(_EBML) and matroska_end(head) > path.stat().st_size:
        return True
    return head.startswith((_EBML, *_OTHERS_WITH_GAPS)) and _has_gap(path)


def matroska_end(head: bytes) -> int:
    """Where Matroska or WebM says that it ends, by its first bytes; 0 where it does not."""
    before, _, segment = head.partition(_SEGMENT)
    if not (before.startswith(_EBML) and segment):
        return 0
    length = 9 - segment[0].bit_length()  # of the number, by its leading zeros
    unknown = (1 << 7 * length) - 1
    size = int.from_bytes(segment[:length]) & unknown
    return 0 if size == unknown else len(before) + len(_SEGMENT) + length + size


def counts_frames(path: Path) -> bool:
    """Whether a file states how many frames are in it, each of which has to come.

    AVI does. MP4 may hide some by an edit; they say by its boxes whether they are whole.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        return file.read(4) == b"RIFF"


def slices_are_whole(packet: bytes) -> bool:
    """Whether the checksum of every slice of an FFV1 frame is right (RFC 9043, 4.9.3).

    The frame is of version 3, with checksums. FFmpeg fills slices that are damaged from the frame
    before, and says so only in its log.
    """
    end = len(packet)
    while end > 0:
        start = end - _SLICE_END - int.from_bytes(packet[max(0, end - 8) : max(0, end - 5)])
        if start < 0 or _crc(packet[start:end]):
            return False
        end = start
    return bool(packet)


def _crc(data: bytes) -> int:
    """CRC-32 that takes the high bit of a byte first and begins with 0, mirrored."""
    return zlib.crc32(data.translate(_MIRRORED), _ONES) ^ _ONES


def _has_gap(path: Path) -> bool:
    """Whether the demuxer stumbles; it goes on behind a damaged place and only logs it."""
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
