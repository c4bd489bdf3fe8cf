"""Image files written byte by byte, for what OpenCV does not write."""

import base64
import struct
import zlib
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image


def encoded(suffix: str, pixels: npt.NDArray[np.generic], *options: int) -> bytes:
    """Gray (H, W) or RGB (H, W, 3), as OpenCV writes it."""
    bgr = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    ok, data = cv2.imencode(suffix, np.ascontiguousarray(bgr), options)
    assert ok
    return data.tobytes()


def written_by_oiio(
    path: Path, pixels: npt.NDArray[Any], tile: tuple[int, int] = (0, 0), **facts: Any
) -> bytes:
    """Pixels (H, W) or (H, W, C) as OpenImageIO writes them, with a tile's width and height.

    In the name of a fact, two underscores stand for the colon.
    """
    import OpenImageIO  # noqa: PLC0415 - of an extra

    height, width, channels = np.atleast_3d(pixels).shape
    kind = {"float32": "float", "float16": "half"}.get(str(pixels.dtype), str(pixels.dtype))
    spec = OpenImageIO.ImageSpec(width, height, channels, kind)
    spec.tile_width, spec.tile_height = tile
    for name, value in facts.items():
        spec[name.replace("__", ":")] = value
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_image(np.ascontiguousarray(pixels)), output.geterror()
    output.close()
    return path.read_bytes()


#: of 8 by 8 gray pixels
JPEG = encoded(".jpg", np.full((8, 8), 128, np.uint8))


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
    tags = Image.Exif()
    tags.endian = order
    tags[0x0112] = orientation
    if focal_35mm is not None:
        tags.get_ifd(0x8769)[0xA405] = focal_35mm
    return tags.tobytes().removeprefix(b"Exif\0\0")


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
    extra: tuple[int, ...] = (),
    longs: Mapping[int, int] | None = None,
) -> bytes:
    """An uncompressed little-endian TIFF of the array's type; (H, W) or (H, W, C).

    ``extra`` are the kinds of the last channels: 0 unknown, 1 associated alpha, 2 unassociated
    alpha. ``longs`` are further tags of one 32-bit number each.
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
        284: [1],
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


def segment(marker: int, body: bytes) -> bytes:
    """A part of a JPEG file."""
    return bytes([0xFF, marker]) + struct.pack(">H", len(body) + 2) + body
