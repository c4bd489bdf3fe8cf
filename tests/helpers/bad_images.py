"""A table of images that no camera made: what each is refused with."""

import struct
from io import BytesIO

import cv2
import numpy as np
import pytest
from PIL import Image

from depthcli.errors import InputError
from depthcli.io.images.read import read_image
from helpers import made

WIDTH, HEIGHT = 96, 64
_NOISE = np.random.default_rng(11).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
PIXELS = cv2.GaussianBlur(_NOISE, (5, 5), 0)
END = b"\xff\xd9"


def encoded(suffix: str, *options: int) -> bytes:
    return made.encoded(suffix, PIXELS[..., ::-1], *options)


def saved(kind: str, mode: str = "RGB", **options: object) -> bytes:
    """The pixels as Pillow writes them."""
    file = BytesIO()
    Image.fromarray(PIXELS).convert(mode).save(file, kind, **options)
    return file.getvalue()


def reason(data: bytes, **options: int) -> str:
    """Why an image is refused, in one line."""
    with pytest.raises(InputError) as caught:
        read_image(None, data, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


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


_FALSE_SUM = bytearray(encoded(".png"))
_FALSE_SUM[len(_FALSE_SUM) // 2] ^= 1

BAD: dict[str, bytes] = {
    "empty": b"",
    "text": b"no image at all",
    "zeros": bytes(1000),
    **{f"{kind} cut": data[: len(data) // 2] for kind, data in JPEGS.items()},
    **{
        f"{kind} cut at {share} %, closed": data[: len(data) * share // 100] + END
        for kind, data in JPEGS.items()
        for share in (50, 75, 90)
    },
    **{
        f"{kind} without its middle": data[: len(data) // 2] + data[len(data) * 3 // 5 :]
        for kind, data in JPEGS.items()
    },
    **{f"{kind} of more rows": _taller(data) for kind, data in JPEGS.items()},
    "JPEG of 12 bits": _bits(JPEGS["baseline"], 12),
    "only fill bytes": b"\xff\xd8" + b"\xff" * 5_000_000,
    "escapes for ever": JPEGS["baseline"][:-2] + b"\xff" * 400_000 + b"\0",
    "TIFF without its last pixels": made.tiff(PIXELS)[:-1],
    "TIFF of a cut directory": made.tiff(PIXELS)[:55],
    "PNG with a false checksum": bytes(_FALSE_SUM),
}
"""Files by what is wrong with them."""
