"""Picture files written byte by byte, for what OpenCV does not write."""

import base64
import struct
import zlib
from collections.abc import Mapping, Sequence
from io import BytesIO

import numpy as np
import numpy.typing as npt
from PIL import Image


def upright_to_stored(pixels: npt.NDArray[np.generic], orientation: int) -> npt.NDArray[np.generic]:
    """What a camera stores so that a viewer that heeds the EXIF orientation shows ``pixels``."""
    return {
        1: lambda p: p,
        2: lambda p: p[:, ::-1],
        3: lambda p: p[::-1, ::-1],
        4: lambda p: p[::-1],
        5: lambda p: p.swapaxes(0, 1),
        6: lambda p: p[:, ::-1].swapaxes(0, 1),
        7: lambda p: p[::-1, ::-1].swapaxes(0, 1),
        8: lambda p: p.swapaxes(0, 1)[:, ::-1],
    }[orientation](pixels)


def exif(orientation: int = 1, focal_35mm: int | None = None, order: str = "<") -> bytes:
    """An EXIF block: a TIFF structure without pixels."""
    tags = [struct.pack(order + "HHIHH", 0x0112, 3, 1, orientation, 0)]
    inner = b""
    if focal_35mm is not None:
        at = 8 + 2 + 2 * 12 + 4
        tags.append(struct.pack(order + "HHII", 0x8769, 4, 1, at))
        inner = struct.pack(order + "HHHIHHI", 1, 0xA405, 3, 1, focal_35mm, 0, 0)
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "IH", 8, len(tags))
    return head + b"".join(tags) + bytes(4) + inner


def jpeg_with_exif(jpeg: bytes, block: bytes) -> bytes:
    body = b"Exif\0\0" + block
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]


def jpeg_with_depth(
    photo: bytes, depth: npt.NDArray[np.uint8], *, orientation: int = 1, **facts: str
) -> bytes:
    """A JPEG with GDepth, the image of which is in segments of extended XMP."""
    Image.fromarray(depth).save(file := BytesIO(), "PNG")
    head = "".join(f' GDepth:{name}="{value}"' for name, value in facts.items())
    xmp = b"http://ns.adobe.com/xap/1.0/\0<x:xmpmeta" + head.encode() + b"/>"
    more = b'<x GDepth:Data="' + base64.b64encode(file.getvalue()) + b'"/>'
    parts = [
        b"http://ns.adobe.com/xmp/extension/\0"
        + b"0" * 32
        + struct.pack(">II", len(more), at)
        + more[at : at + 200]
        for at in range(0, len(more), 200)
    ]
    image = jpeg_with_exif(photo, exif(orientation))
    segments = b"".join(segment(0xE1, part) for part in [xmp, *parts[::-1]])
    return image[:2] + segments + image[2:]


def png_with_exif(png: bytes, block: bytes) -> bytes:
    return png[:33] + chunk(b"eXIf", block) + png[33:]


def webp_with_exif(webp: bytes, block: bytes, width: int, height: int) -> bytes:
    size = b"".join((n - 1).to_bytes(3, "little") for n in (width, height))
    extended = b"VP8X" + struct.pack("<I", 10) + bytes([8, 0, 0, 0]) + size
    tail = b"EXIF" + struct.pack("<I", len(block)) + block + bytes(len(block) % 2)
    body = b"WEBP" + extended + webp[12:] + tail
    return b"RIFF" + struct.pack("<I", len(body)) + body


def chunk(kind: bytes, body: bytes) -> bytes:
    """One PNG chunk."""
    crc = struct.pack(">I", zlib.crc32(kind + body))
    return struct.pack(">I", len(body)) + kind + body + crc


def png(
    rows: Sequence[bytes], width: int, depth: int, colour: int, *chunks: bytes, height: int = -1
) -> bytes:
    """A PNG of unfiltered rows; ``colour`` is 0 gray, 2 RGB, 3 palette, 4 gray + alpha, 6 RGBA."""
    size = struct.pack(">II", width, len(rows) if height < 0 else height)
    head = chunk(b"IHDR", size + bytes([depth, colour, 0, 0, 0]))
    data = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row for row in rows)))
    return b"\x89PNG\r\n\x1a\n" + head + b"".join(chunks) + data + chunk(b"IEND", b"")


def tiff(
    pixels: npt.NDArray[np.generic],
    orientation: int = 1,
    photometric: int = -1,
    planes: int = 1,
    extra: tuple[int, ...] = (),
    longs: Mapping[int, int] | None = None,
) -> bytes:
    """An uncompressed little-endian TIFF of the array's type; (H, W) or (H, W, C).

    With two ``planes`` the header says that each channel is by itself. ``extra`` are the kinds of
    the last channels: 0 unknown, 1 associated alpha, 2 unassociated alpha. ``longs`` are
    further tags of one 32-bit number each.
    """
    height, width = pixels.shape[:2]
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if photometric < 0:
        photometric = 1 if channels == 1 else 2
    sample = {"u": 1, "i": 2, "f": 3}[pixels.dtype.kind]
    words = {
        258: [pixels.dtype.itemsize * 8] * channels,
        259: [1],
        262: [photometric],
        274: [orientation],
        277: [channels],
        284: [planes],
        339: [sample] * channels,
    } | ({338: [*extra]} if extra else {})
    longs = {256: width, 257: height, 273: 0, 278: height, 279: pixels.nbytes} | dict(longs or {})
    count = len(words) + len(longs)
    at = 8 + 2 + 12 * count + 4
    longs[273] = at + 32
    lists, tags = b"", b""
    for tag in sorted({**words, **longs}):
        if tag in longs:
            tags += struct.pack("<HHII", tag, 4, 1, longs[tag])
            continue
        value = struct.pack(f"<{len(words[tag])}H", *words[tag])
        tags += struct.pack("<HHI", tag, 3, len(words[tag]))
        tags += value.ljust(4, b"\0") if len(value) <= 4 else struct.pack("<I", at + len(lists))
        lists += value if len(value) > 4 else b""
    head = b"II*\0" + struct.pack("<IH", 8, count)
    return head + tags + bytes(4) + lists.ljust(32, b"\0") + np.ascontiguousarray(pixels).tobytes()


def jpeg(blocks: Sequence[Sequence[int]], adobe: int | None = None) -> bytes:
    """A baseline JPEG, one row of flat 8x8 blocks; each block has one sample a component.

    Args:
        blocks: (blocks, components) samples, 0-255.
        adobe: colour transform that an Adobe marker states: 0 none (CMYK), 2 YCCK.
    """
    count = len(blocks[0])
    app14 = b"" if adobe is None else segment(0xEE, b"Adobe\0\x64" + bytes(4) + bytes([adobe]))
    parts = b"".join(bytes([i + 1, 0x11, 0]) for i in range(count))
    frame = struct.pack(">BHHB", 8, 8, 8 * len(blocks), count) + parts
    # Twelve DC lengths with a code of four bits each; AC knows only the end of the block.
    huffman = bytes([0, 0, 0, 0, 12]) + bytes(12) + bytes(range(12))
    huffman += bytes([0x10, 1]) + bytes(15) + bytes([0])
    scan = bytes([count]) + b"".join(bytes([i + 1, 0]) for i in range(count)) + bytes([0, 63, 0])
    head = app14 + segment(0xDB, bytes([0]) + bytes([1] * 64)) + segment(0xC0, frame)
    head += segment(0xC4, huffman) + segment(0xDA, scan)
    return b"\xff\xd8" + head + _entropy_coded(blocks) + b"\xff\xd9"


def segment(marker: int, body: bytes) -> bytes:
    """A part of a JPEG file."""
    return bytes([0xFF, marker]) + struct.pack(">H", len(body) + 2) + body


def _entropy_coded(blocks: Sequence[Sequence[int]]) -> bytes:
    bits, before = "", [0] * len(blocks[0])
    for block in blocks:
        for i, sample in enumerate(block):
            level = 8 * (sample - 128)  # the DC coefficient of a flat block, quantized by 1
            step, before[i] = level - before[i], level
            length = abs(step).bit_length()
            bits += f"{length:04b}"
            if length:
                bits += f"{step if step > 0 else step + (1 << length) - 1:0{length}b}"
            bits += "0"  # end of block
    bits += "1" * (-len(bits) % 8)
    data = int(bits, 2).to_bytes(len(bits) // 8, "big")
    return data.replace(b"\xff", b"\xff\0")


def bmp(
    rows: Sequence[bytes], width: int, bits: int = 24, *, start: int = 54, masks: Sequence[int] = ()
) -> bytes:
    """A BMP of rows from top to bottom, whole multiples of four bytes; masks of red, green, blue.

    With a ``start`` of 26 it has the header of OS/2.
    """
    if start == 26:
        header = struct.pack("<IHHHH", 12, width, len(rows), 1, bits)
    else:
        size = struct.pack("<IiiHH", 40, width, len(rows), 1, bits)
        header = size + struct.pack("<I", 3 if masks else 0) + bytes(20)
        header += b"".join(struct.pack("<I", mask) for mask in masks)
    return b"BM" + struct.pack("<III", 0, 0, start) + header + b"".join(reversed(rows))
