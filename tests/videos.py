"""Small videos, made when a test needs them."""

from __future__ import annotations

import struct
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from depthcli.io.ffmpeg_log import silent_ffmpeg
from depthcli.io.mp4_finish import finish_mp4, opencv_rate

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

NTSC = Fraction(30000, 1001)


def write_video(
    path: Path, frames: Iterable[np.ndarray[Any, Any]], rate: Fraction = Fraction(25)
) -> Path:
    """RGB frames as Motion JPEG, whose frames are independent and near to what went in."""
    writer = None
    path.parent.mkdir(parents=True, exist_ok=True)
    for frame in frames:
        if writer is None:
            size = (frame.shape[1], frame.shape[0])
            code = cv2.VideoWriter.fourcc(*"MJPG")
            with silent_ffmpeg():
                writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, float(rate), size)
            assert writer.isOpened()
            writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
    assert writer is not None
    writer.release()
    return path


def write_mp4(
    path: Path,
    frames: Sequence[np.ndarray[Any, Any]],
    rate: Fraction = NTSC,
    times_s: Sequence[float] | None = None,
) -> Path:
    """RGB frames as MPEG-4 with the exact rate, or with times of their own."""
    height, width = frames[0].shape[:2]
    code = cv2.VideoWriter.fourcc(*"mp4v")
    size = (width, height)
    with silent_ffmpeg():
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, opencv_rate(rate), size)
    assert writer.isOpened()
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
    writer.release()
    finish_mp4(path, rate, times_s or [float(i / rate) for i in range(len(frames))])
    return path


def flat_frames(
    levels: Iterable[int], height: int = 48, width: int = 64
) -> list[np.ndarray[Any, np.dtype[np.uint8]]]:
    """Gray frames, each of one brightness."""
    return [np.full((height, width, 3), level, np.uint8) for level in levels]


def turned(mp4: bytes) -> bytes:
    """The same file with a track that asks to be shown turned clockwise, as phones write it."""
    at = mp4.index(b"tkhd") + 4 + 40  # version 0: the matrix follows 40 bytes
    one, whole = 1 << 16, 1 << 30
    matrix = struct.pack(">9i", 0, one, 0, -one, 0, 0, 0, 0, whole)
    return mp4[:at] + matrix + mp4[at + len(matrix) :]


def trimmed(mp4: bytes, start_s: float, length_s: float) -> bytes:
    """The same file with an edit that shows only a part, as trimming without encoding leaves it."""
    at = mp4.index(b"elst") + 4
    media = mp4.index(b"mdhd") + 4
    movie_ticks, media_ticks = (
        int.from_bytes(mp4[clock : clock + 4]) for clock in (mp4.index(b"mvhd") + 16, media + 12)
    )
    edit = struct.pack(">IiI", round(length_s * movie_ticks), round(start_s * media_ticks), 1 << 16)
    return mp4[: at + 8] + edit + mp4[at + 8 + len(edit) :]


def header_first(mp4: bytes) -> bytes:
    """The same file with its header before its frames, so that it can be cut."""
    at = mp4.index(b"moov") - 4
    start = mp4.index(b"mdat") - 4
    header = bytearray(mp4[at:])
    table = header.index(b"stco") + 8
    count = int.from_bytes(header[table : table + 4])
    for i in range(count):
        place = table + 4 + 4 * i
        struct.pack_into(
            ">I", header, place, int.from_bytes(header[place : place + 4]) + len(header)
        )
    return mp4[:start] + bytes(header) + mp4[start:at]
