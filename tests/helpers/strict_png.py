"""A PNG reader that forgives nothing, written from the specification alone."""

import struct
import zlib
from typing import NamedTuple

import numpy as np

CHANNELS = {0: 1, 2: 3}


class Strict(NamedTuple):
    """What a file holds, in order."""

    kinds: tuple[bytes, ...]
    pixels: np.ndarray


def read_strictly(png: bytes) -> Strict:
    """Check signature, lengths, checksums and order of chunks, zlib's frame, and every filter."""
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    chunks = []
    at = 8
    while at < len(png):
        (length,) = struct.unpack_from(">I", png, at)
        kind, body = png[at + 4 : at + 8], png[at + 8 : at + 8 + length]
        assert len(body) == length
        (check,) = struct.unpack_from(">I", png, at + 8 + length)
        assert check == zlib.crc32(kind + body)
        chunks.append((kind, body))
        at += 12 + length
    kinds = tuple(kind for kind, _ in chunks)
    assert kinds[0] == b"IHDR"
    assert kinds[-1] == b"IEND"
    assert chunks[-1][1] == b""
    first = kinds.index(b"IDAT")
    assert set(kinds[1:first]) <= {b"tEXt", b"iTXt"}
    assert set(kinds[first:-1]) == {b"IDAT"}
    return Strict(kinds, _pixels(chunks[0][1], b"".join(b for k, b in chunks if k == b"IDAT")))


def _pixels(header: bytes, data: bytes) -> np.ndarray:
    width, height, bits, colour, compression, filters, interlace = struct.unpack(">IIBBBBB", header)
    assert (compression, filters, interlace) == (0, 0, 0)
    inflating = zlib.decompressobj()  # checks the Adler-32 at the end
    raw = inflating.decompress(data)
    assert inflating.eof
    assert not inflating.unused_data
    step = CHANNELS[colour] * bits // 8
    stride = width * step
    assert len(raw) == height * (stride + 1)
    above = bytes(stride)
    rows = []
    for start in range(0, len(raw), stride + 1):
        above = _row(raw[start], raw[start + 1 : start + 1 + stride], above, step)
        rows.append(above)
    values = np.frombuffer(b"".join(rows), f">u{bits // 8}")
    shape = (height, width) if colour == 0 else (height, width, 3)
    return values.reshape(shape).astype(f"u{bits // 8}")


def _row(filtered_by: int, row: bytes, above: bytes, step: int) -> bytes:
    """Undo one row's filter, byte by byte."""
    out = bytearray()
    for i, byte in enumerate(row):
        left = out[i - step] if i >= step else 0
        corner = above[i - step] if i >= step else 0
        out.append((byte + _predicted(filtered_by, left, above[i], corner)) & 0xFF)
    return bytes(out)


def _predicted(filtered_by: int, left: int, up: int, corner: int) -> int:
    if filtered_by == 4:
        return min((left, up, corner), key=lambda value: abs(left + up - corner - value))
    return {0: 0, 1: left, 2: up, 3: (left + up) // 2}[filtered_by]
