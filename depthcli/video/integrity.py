"""Checks that a video file is complete, by checksums and by what FFmpeg's demuxer reports."""

import zlib
from pathlib import Path

import av
from av import logging as av_logging

from depthcli.video.container import open_video

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
