"""Detecting truncated video files by the length that their container states."""

import os
from typing import BinaryIO

HEAD_BYTES = 4096
"""Of a file, in which its container states what is read here."""
_MP4_FIRST_BOXES = {b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip"}
_MP4_BOXES = _MP4_FIRST_BOXES | {b"moof", b"mfra", b"sidx", b"styp", b"meta", b"udta", b"uuid"}
"""Those that can follow a complete video; anything else behind it is the trailer of a camera."""
_MP4_BOX_HEAD_BYTES = 8
_ASF = bytes.fromhex("3026b2758e66cf11a6d900aa0062ce6c")
_ASF_FILE_PROPERTIES = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")
_ASF_SIZE = slice(40, 48)  # bytes of the properties
_OGG, _OGG_END, _OGG_HEADER, _OGG_PAGE = b"OggS", 4, 27, 65_307
_GIF_FLAGS = 10
AVI_UNKNOWN_FRAMES = 1 << 30
"""The length that FFmpeg states in an AVI that it writes into a pipe."""
_AVI_UNKNOWN_SIZE = b"\xff" * 4
_AVI_LENGTH = slice(36, 40)  # bytes after "strh", which begins the header of a stream
_TS_PACKETS = ((0, 188), (4, 192))
"""Of transport streams: offset of the sync byte and length of a packet."""
_TS_SYNC_BYTE = 0x47


def is_truncated(file: BinaryIO, head: bytes) -> bool:
    """Whether a file ends before the length that MP4, MOV, AVI, WMV, Ogg, GIF or MPEG-TS states.

    Other containers state none.

    Args:
        file: open for reading, at any position.
        head: its first ``HEAD_BYTES`` bytes.

    Raises:
        OSError: it cannot be read.
    """
    size = file.seek(0, os.SEEK_END)
    if head[4:8] in _MP4_FIRST_BOXES:
        return _mp4_end(file, size) > size
    if head.startswith(b"RIFF"):
        return int.from_bytes(head[4:8], "little") + 8 > size and not _has_unstated_size(head)
    if head.startswith(_ASF):
        properties = head[head.find(_ASF_FILE_PROPERTIES) :]
        return (
            properties.startswith(_ASF_FILE_PROPERTIES)
            and int.from_bytes(properties[_ASF_SIZE], "little") > size
        )
    if head.startswith(b"GIF8"):
        return not _has_gif_trailer(file)
    if head.startswith(_OGG):
        file.seek(max(0, size - _OGG_PAGE))
        return not _has_ogg_end(file.read())
    return ends_within_packet(head, size)


def ends_within_packet(head: bytes, size: int) -> bool:
    """Whether a transport stream, by its first bytes and its size, ends within a packet."""
    lengths = (n for at, n in _TS_PACKETS if head[at::n].strip(bytes([_TS_SYNC_BYTE])) == b"")
    return bool(head) and any(size % length for length in lengths)


def _has_unstated_size(head: bytes) -> bool:
    """Whether an AVI was written where its size could not be filled in, such as into a pipe.

    If the writing was interrupted instead, its streams have a length of 0.
    """
    _, _, stream = head.partition(b"strh")
    return head[4:8] == _AVI_UNKNOWN_SIZE and any(stream[_AVI_LENGTH])


def _has_gif_trailer(file: BinaryIO) -> bool:
    """Whether blocks follow each other up to the trailer (GIF89a, 12)."""
    file.seek(_GIF_FLAGS)
    _skip_color_table(file, file.read(1))
    file.seek(2, os.SEEK_CUR)
    while (kind := file.read(1)) in (b"!", b","):
        if kind == b",":
            file.seek(8, os.SEEK_CUR)
            _skip_color_table(file, file.read(1))
        file.seek(1, os.SEEK_CUR)
        while size := int.from_bytes(file.read(1)):
            file.seek(size, os.SEEK_CUR)
    return kind == b";"


def _skip_color_table(file: BinaryIO, flags: bytes) -> None:
    if flags and flags[0] & 0x80:
        file.seek(3 << (flags[0] & 7) + 1, os.SEEK_CUR)


def _has_ogg_end(tail: bytes) -> bool:
    """Whether the last page is complete, and the last of its stream (RFC 3533, 6)."""
    page = tail[tail.rfind(_OGG) :]
    if len(page) < _OGG_HEADER or not page[5] & _OGG_END:
        return False
    parts = page[_OGG_HEADER : _OGG_HEADER + page[26]]
    return _OGG_HEADER + page[26] + sum(parts) <= len(page)


def _mp4_end(file: BinaryIO, file_size: int) -> int:
    """Where the last box ends; more than the size of the file if it ends within the box's head."""
    at = 0
    found = set[bytes]()
    while at < file_size:
        file.seek(at)
        head = file.read(16)
        kind = head[4:8]
        if {b"moov", b"mdat"} <= found and kind not in _MP4_BOXES:
            return at
        if len(head) < _MP4_BOX_HEAD_BYTES:
            return file_size + 1
        found.add(kind)
        size = int.from_bytes(head[:4])
        if size == 0:  # the box extends to the end of the file
            return file_size
        at += max(8, int.from_bytes(head[8:]) if size == 1 else size)
    return at
