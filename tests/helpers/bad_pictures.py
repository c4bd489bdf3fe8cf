"""A table of pictures that no camera made: what each is refused with."""

from __future__ import annotations

import struct

import cv2
import numpy as np

from helpers import made

WIDTH, HEIGHT = 96, 64
_NOISE = np.random.default_rng(11).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
PIXELS = cv2.GaussianBlur(_NOISE, (5, 5), 0)
END = b"\xff\xd9"


def encoded(suffix: str, *options: int) -> bytes:
    ok, data = cv2.imencode(suffix, PIXELS, options)
    assert ok
    return data.tobytes()


JPEGS = {
    "baseline": encoded(".jpg"),
    "progressive": encoded(".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "restarts": encoded(".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 4),
}


def _taller(jpeg: bytes) -> bytes:
    data = bytearray(jpeg)
    at = next(data.find(mark) for mark in (b"\xff\xc0\0", b"\xff\xc2\0") if mark in data)
    struct.pack_into(">H", data, at + 5, 2 * HEIGHT)
    return bytes(data)


def _bits(jpeg: bytes, bits: int) -> bytes:
    data = bytearray(jpeg)
    data[data.index(b"\xff\xc0\0") + 4] = bits
    return bytes(data)


def _tiff(compression: int) -> bytes:
    data = bytearray(made.tiff(PIXELS))
    struct.pack_into("<H", data, data.index(struct.pack("<HHI", 259, 3, 1)) + 8, compression)
    return bytes(data)


def _bigtiff(directory: int, entries: int) -> bytes:
    return b"II+\0" + struct.pack("<HHQQ", 8, 0, directory, entries) + bytes(200)


def _without_middle(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes(40) + data[middle + 40 :]


def _without_first(tiff: bytes) -> bytes:
    """OpenCV puts the pixels right after the eight bytes of the header."""
    return tiff[:8] + b"\x81" * 40 + tiff[48:]


_DEFLATED = [
    encoded(".tiff", cv2.IMWRITE_TIFF_COMPRESSION, 8, *options)
    for options in ((), (cv2.IMWRITE_TIFF_ROWSPERSTRIP, 8))
]
_IS_TOLD = int(cv2.__version__.partition(".")[0]) > 4  # what libtiff finds; OpenCV 4 does not
_CHECKED_BY_LIBTIFF = {"LZW": 5, "PackBits": 32773} if _IS_TOLD else {}
_DEEP = PIXELS.astype(np.uint16) * 257
_ROWS = [row.tobytes() for row in PIXELS]
_LOST = "is damaged, or of a variant that cannot be decoded; save it again"
_NO_PICTURE = "is not a picture"

BAD: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty"),
    "text": (b"no picture at all", _NO_PICTURE),
    "zeros": (bytes(1000), _NO_PICTURE),
    **{f"{kind} cut": (data[: len(data) // 2], "truncated") for kind, data in JPEGS.items()},
    **{
        f"{kind} cut at {share} %, closed": (data[: len(data) * share // 100] + END, _LOST)
        for kind, data in JPEGS.items()
        for share in (50, 75, 90)
    },
    **{
        f"{kind} without its middle": (data[: len(data) // 2] + data[len(data) * 3 // 5 :], _LOST)
        for kind, data in JPEGS.items()
    },
    **{f"{kind} of more rows": (_taller(data), _LOST) for kind, data in JPEGS.items()},
    "JPEG of 12 bits": (_bits(JPEGS["baseline"], 12), _LOST),
    "only fill bytes": (b"\xff\xd8" + b"\xff" * 5_000_000, _NO_PICTURE),
    "escapes for ever": (JPEGS["baseline"][:-2] + b"\xff" * 400_000 + b"\0", "truncated"),
    **{f"TIFF of coding {n}": (_tiff(n), f"TIFF compression {n};") for n in (0, 9, 12345, 34712)},
    **{
        f"TIFF of damaged Deflate {number}": (_without_middle(data), "cannot be inflated")
        for number, data in enumerate(_DEFLATED)
    },
    **{
        f"TIFF of damaged {kind}": (
            _without_first(encoded(".tiff", cv2.IMWRITE_TIFF_COMPRESSION, coding)),
            _LOST,
        )
        for kind, coding in _CHECKED_BY_LIBTIFF.items()
    },
    "TIFF without its last pixels": (made.tiff(PIXELS)[:-1], "pixels of the TIFF are missing"),
    "TIFF of a cut directory": (made.tiff(PIXELS)[:55], "directory is incomplete"),
    "TIFF of 16 bits in planes": (made.tiff(_DEEP, planes=2), "a plane for each colour"),
    "TIFF of floats in planes": (made.tiff(_DEEP / 65535, planes=2), "a plane for each colour"),
    "TIFF of 16 bits with a white 0": (made.tiff(_DEEP[..., 0], photometric=0), "0 for white"),
    "BMP without room for its header": (made.bmp(_ROWS, WIDTH, start=40), "within its header"),
    "BMP of red before green": (
        made.bmp(_ROWS, WIDTH * 3 // 4, 32, start=66, masks=(0xFF, 0xFF00, 0xFF0000)),
        "unusual order of colours",
    ),
    "BigTIFF of no 64 bits": (_bigtiff(2**64 - 1, 1), _NO_PICTURE),
    "BigTIFF beyond the end": (_bigtiff(2**63, 1), _NO_PICTURE),
    "BigTIFF of all tags": (_bigtiff(16, 2**64 - 1), _NO_PICTURE),
}
"""Name -> (the file, a part of the message)."""
