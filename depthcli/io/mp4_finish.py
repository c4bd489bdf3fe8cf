"""Exact times for MP4 files that OpenCV wrote.

OpenCV rounds a frame rate to three decimals. The header stands at the end of the file, so it is
written anew (ISO/IEC 14496-12, ISO base media file format).
"""

from __future__ import annotations

import os
import struct
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Sequence
    from fractions import Fraction
    from pathlib import Path
    from typing import BinaryIO

_PARENTS = {b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts"}
_FINEST_TICKS = 10_000
_FALLBACK_TICKS = 90_000
_MOST_TICKS = 1 << 31
_ON_GRID = 1e-6


class Clock(NamedTuple):
    """Times of frames in whole ticks.

    Attributes:
        ticks_per_s: ticks in a second.
        steps: ticks from each frame to the next; the last frame's own length at the end.
    """

    ticks_per_s: int
    steps: tuple[int, ...]


def opencv_rate(rate: Fraction) -> float:
    """A rate that OpenCV's writer and MPEG-4 have room for; :func:`finish_mp4` makes it exact."""
    steps = next((n for n in (1, 10, 100, 1000) if rate * n >= 1), 1000)
    return max(1, int(rate * steps)) / steps


def clock(rate: Fraction, times_s: Sequence[float]) -> Clock:
    """Ticks for frames: exact where they lie on the rate's grid, else to 1/90000 s.

    Args:
        rate: frames a second.
        times_s: of each frame from the first, in seconds.
    """
    count = len(times_s)
    finer = -(-_FINEST_TICKS // rate.numerator)
    ticks, step = rate.numerator * finer, rate.denominator * finer
    regular = all(abs(time * rate - i) < _ON_GRID for i, time in enumerate(times_s))
    if regular and ticks < _MOST_TICKS and count * step < _MOST_TICKS:
        return Clock(ticks, (step,) * count)
    ends = [*times_s, times_s[-1] + float(1 / rate)]
    at = [round(time * _FALLBACK_TICKS) for time in ends]
    return Clock(_FALLBACK_TICKS, tuple(b - a for a, b in pairwise(at)))


def finish_mp4(path: Path, rate: Fraction, times_s: Sequence[float]) -> None:
    """Give a file the time of every frame.

    Args:
        path: one video track without reordered frames, as OpenCV closed it.
        rate: frames a second.
        times_s: of each frame from the first, in seconds.

    Raises:
        ValueError: the file is incomplete or has another number of frames.
        OSError: it cannot be read or written.
    """
    with path.open("r+b") as file:
        offset, header = _header(file)
        exact = _rewritten(header, clock(rate, times_s))
        file.seek(offset)
        file.write(exact)
        file.truncate()


def _header(file: BinaryIO) -> tuple[int, bytes]:
    """The last box of a file, which has to be its header, and where it stands."""
    end, at = file.seek(0, os.SEEK_END), 0
    while True:
        file.seek(at)
        head = file.read(16)
        if len(head) < 8:  # noqa: PLR2004
            break
        size, kind = struct.unpack_from(">I4s", head)
        size = int.from_bytes(head[8:]) if size == 1 else size
        if size < 8 or at + size > end:  # noqa: PLR2004
            break
        if kind == b"moov" and at + size == end:
            file.seek(at)
            return at, file.read(size)
        at += size
    msg = "the file is not whole"
    raise ValueError(msg)


def _rewritten(box: bytes, clock: Clock) -> bytes:
    """A box and all in it, with the clock's times."""
    kind, body = box[4:8], box[8:]
    if kind in _PARENTS:
        parts, at = [], 0
        while at < len(body):
            size = int.from_bytes(body[at : at + 4])
            parts.append(_rewritten(body[at : at + size], clock))
            at += size
        body = b"".join(parts)
    elif kind == b"stts":
        body = _steps(clock)
    elif kind == b"stsz":
        _check_count(body, clock)
    elif kind in {b"mvhd", b"tkhd", b"mdhd", b"elst"}:
        body = _timed(kind, body, clock)
    return struct.pack(">I4s", len(body) + 8, kind) + body


def _steps(clock: Clock) -> bytes:
    runs = [(len(list(run)), step) for step, run in groupby(clock.steps)]
    table = b"".join(struct.pack(">II", count, step) for count, step in runs)
    return bytes(4) + struct.pack(">I", len(runs)) + table


def _check_count(body: bytes, clock: Clock) -> None:
    (count,) = struct.unpack_from(">I", body, 8)
    if count != len(clock.steps):
        msg = f"{count} of {len(clock.steps)} frames are in the file"
        raise ValueError(msg)


def _timed(kind: bytes, body: bytes, clock: Clock) -> bytes:
    """A header box with its length in time; all have one in 32 bits, or 64 in version 1."""
    long = body[0] == 1
    number = ">Q" if long else ">I"
    data = bytearray(body)
    total = sum(clock.steps)
    if kind == b"mdhd":
        at = 20 if long else 12
        struct.pack_into(">I", data, at, clock.ticks_per_s)
        struct.pack_into(number, data, at + 4, total)
        return bytes(data)
    at = {b"mvhd": (24, 16), b"tkhd": (28, 20), b"elst": (8, 8)}[kind][not long]
    # These three count in the movie's milliseconds, as FFmpeg writes it.
    struct.pack_into(number, data, at, -(-total * 1000 // clock.ticks_per_s))
    return bytes(data)
