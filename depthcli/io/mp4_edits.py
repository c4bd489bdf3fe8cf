"""Whether an MP4 or MOV file shows every frame that it counts (ISO/IEC 14496-12)."""

from __future__ import annotations

import os
import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import BinaryIO

_ROUNDING_S = 0.002  # edits count in the movie's ticks, which are mostly milliseconds
_EDIT = {0: ">IiI", 1: ">QqI"}
_CLOCK = {0: (">II", 12), 1: (">IQ", 20)}


def shows_every_frame(file: BinaryIO) -> bool:
    """Whether the number of frames in an MP4's header is the number that a player shows.

    It is not where an edit hides some, as after trimming without a new encoding, nor where the
    frames come in fragments.

    Args:
        file: open for reading; its position is moved.
    """
    try:
        header = _header(file)
        return _inside(header, b"mvex") is None and not _hides_frames(header)
    except (ValueError, struct.error, KeyError):  # damaged: it says nothing that can be trusted
        return False


def _header(file: BinaryIO) -> bytes:
    end, at = file.seek(0, os.SEEK_END), 0
    while at < end:
        file.seek(at)
        head = file.read(16)
        size, kind = struct.unpack_from(">I4s", head)
        if kind == b"moov":
            file.seek(at + 8)
            return file.read(size - 8)
        at += max(8, int.from_bytes(head[8:]) if size == 1 else size or end)
    msg = "no header"
    raise ValueError(msg)


def _hides_frames(header: bytes) -> bool:
    ticks_per_s, _ = _clock(header, b"mvhd")
    for kind, track in _boxes(header):
        if kind != b"trak" or _found(track, b"mdia", b"hdlr")[8:12] != b"vide":
            continue
        edits = _inside(track, b"edts", b"elst")
        media_ticks_per_s, length = _clock(_found(track, b"mdia"), b"mdhd")
        if edits is None or not ticks_per_s or not media_ticks_per_s:
            return False
        return _shown(edits) / ticks_per_s < length / media_ticks_per_s - _ROUNDING_S
    return False


def _shown(edits: bytes) -> int:
    """Ticks that an edit list shows; empty edits, which only wait, do not count."""
    row = struct.Struct(_EDIT[edits[0]])
    rows = (row.unpack_from(edits, at) for at in range(8, len(edits) - row.size + 1, row.size))
    return sum(ticks for ticks, media_time, _ in rows if media_time >= 0)


def _clock(parent: bytes, kind: bytes) -> tuple[int, int]:
    """Ticks a second and length in ticks, of ``mvhd`` or ``mdhd``."""
    body = _found(parent, kind)
    form, at = _CLOCK[body[0]]
    ticks_per_s, length = struct.unpack_from(form, body, at)
    return ticks_per_s, length


def _found(parent: bytes, *kinds: bytes) -> bytes:
    body = _inside(parent, *kinds)
    if not body:
        msg = f"no {kinds[-1]!r}"
        raise ValueError(msg)
    return body


def _inside(parent: bytes, *kinds: bytes) -> bytes | None:
    """The body of the first box of a kind in a box, in it the first of the next kind, and so on."""
    body: bytes | None = parent
    for kind in kinds:
        body = next((inner for found, inner in _boxes(body or b"") if found == kind), None)
    return body


def _boxes(body: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and body of the boxes in a box."""
    at = 0
    while at + 8 <= len(body):
        size = int.from_bytes(body[at : at + 4])
        yield body[at + 4 : at + 8], body[at + 8 : at + size]
        at += max(8, size)
