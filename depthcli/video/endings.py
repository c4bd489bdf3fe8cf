"""Whether a video file ends where its container says that it does."""

import os
from typing import BinaryIO

_HEAD_BYTES = 4096
_MP4_STARTS = {b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip"}
_ASF = bytes.fromhex("3026b2758e66cf11a6d900aa0062ce6c")
_ASF_FACTS = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")
_ASF_SIZE = slice(40, 48)  # bytes of the facts
_OGG, _OGG_END, _OGG_HEADER, _OGG_PAGE = b"OggS", 4, 27, 65_307
_GIF_FLAGS = 10
_TS_PACKETS = ((0, 188), (4, 192))
"""Of transport streams: where the byte that begins each packet is, and how long packets are."""
_TS_START = 0x47


def ends_early(file: BinaryIO) -> bool:
    """Whether an end is missing, by what MP4, MOV, AVI, WMV, Ogg, GIF and transport streams say.

    Other containers say nothing.

    Raises:
        OSError: it cannot be read.
    """
    head, end = file.read(_HEAD_BYTES), file.seek(0, os.SEEK_END)
    if head[4:8] in _MP4_STARTS:
        return _mp4_end(file, end) > end
    if head.startswith(b"RIFF"):
        return int.from_bytes(head[4:8], "little") + 8 > end
    if head.startswith(_ASF):
        facts = head[head.find(_ASF_FACTS) :]
        return facts.startswith(_ASF_FACTS) and int.from_bytes(facts[_ASF_SIZE], "little") > end
    if head.startswith(b"GIF8"):
        return not _gif_ends(file)
    if head.startswith(_OGG):
        file.seek(max(0, end - _OGG_PAGE))
        return not _ogg_ends(file.read())
    return breaks_off(head, end)


def breaks_off(head: bytes, end: int) -> bool:
    """Whether a transport stream of these first bytes and this length ends within a packet."""
    lengths = (n for at, n in _TS_PACKETS if head[at::n].strip(bytes([_TS_START])) == b"")
    return bool(head) and any(end % length for length in lengths)


def _gif_ends(file: BinaryIO) -> bool:
    """Whether one block follows the other up to the trailer (GIF89a, 12)."""
    file.seek(_GIF_FLAGS)
    _pass_colours(file, file.read(1))
    file.seek(2, os.SEEK_CUR)
    while (kind := file.read(1)) in (b"!", b","):
        if kind == b",":
            file.seek(8, os.SEEK_CUR)
            _pass_colours(file, file.read(1))
        file.seek(1, os.SEEK_CUR)
        while size := int.from_bytes(file.read(1)):
            file.seek(size, os.SEEK_CUR)
    return kind == b";"


def _pass_colours(file: BinaryIO, flags: bytes) -> None:
    if flags and flags[0] & 0x80:
        file.seek(3 << (flags[0] & 7) + 1, os.SEEK_CUR)


def _ogg_ends(tail: bytes) -> bool:
    """Whether the last page is whole, and the last of its stream (RFC 3533, 6)."""
    page = tail[tail.rfind(_OGG) :]
    if len(page) < _OGG_HEADER or not page[5] & _OGG_END:
        return False
    parts = page[_OGG_HEADER : _OGG_HEADER + page[26]]
    return _OGG_HEADER + page[26] + sum(parts) <= len(page)


def _mp4_end(file: BinaryIO, end: int) -> int:
    """Where the last box ends."""
    at = 0
    while at < end:
        file.seek(at)
        head = file.read(16)
        if len(head) < 8:  # noqa: PLR2004
            return end + 1
        size = int.from_bytes(head[:4])
        if size == 0:  # up to the end of the file, wherever that is
            return end
        at += max(8, int.from_bytes(head[8:]) if size == 1 else size)
    return at
