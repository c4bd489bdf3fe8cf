"""Images that OpenCV decodes, in silence; headers of WebP, GIF, BMP and Netpbm."""

import re
import struct
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from depthcli.core.types import AnyArray
from depthcli.errors import InputError

ANIMATED = "is animated; only the first image is used"  #: a warning
_WEBP_ANIMATION = 0x02  # of the flags of an extended file
_GIF_FRAME = b"\0\x21\xf9\x04"  # the end of a block, and a graphic control extension
_NUMBER = rb"\s+(?:#[^\n]*\n\s*)*(\d{1,9})"
_NETPBM = re.compile(rb"P[1-6]" + 2 * _NUMBER + rb"(?:" + _NUMBER + rb")?(?:\r\n|\s)")
"""Width, height and, except for bitmaps, the value of white."""
_BITMAPS, _PLAIN = (b"P1", b"P4"), (b"P2", b"P3")
_BYTE = 0xFF
_OS2_HEAD = b"\x0c\0\0\0"  # bytes of the header of a BMP of OS/2


class Header(NamedTuple):
    """Facts about the first image of a file, known before it is decoded."""

    width: int
    height: int
    warning: str | None = None  #: about further images in the file
    white: int | None = None  #: value of white, if the file states one
    orientation: int | None = None  #: 1-8; None for that of its EXIF
    is_upright: bool = False  #: whether its decoder turns it by this orientation
    profile: bytes = b""  #: its ICC profile, if that is compressed in the file
    transfer: int = 0  #: code of the transfer function in ITU-T H.273; 0 for none


class Decoded(NamedTuple):
    """Pixels of an image, and what is known once it is decoded."""

    pixels: AnyArray  #: gray (H, W) or RGB (H, W, 3), of the file's own type
    exif: bytes = b""  #: the TIFF structure that EXIF is; empty without one
    is_limited: bool = False  #: whether gray is from 16 to 235 of 256 steps, as of video
    is_linear: bool = False  #: whether it is linear light and not encoded for display
    alpha: AnyArray | None = None  #: (H, W), opacity of the type of the pixels; None if all
    pixel_aspect: float = 1.0  #: width by height of a pixel


def is_webp(data: bytes) -> bool:
    """Whether a file is a WebP."""
    return data[:4] == b"RIFF" and data[8:12] == b"WEBP"


def webp_header(data: bytes) -> Header:
    """Header of a WebP (RFC 9649)."""
    kind = data[12:16]
    if kind == b"VP8X":
        width, height = (int.from_bytes(data[at : at + 3], "little") + 1 for at in (24, 27))
        return Header(width, height, ANIMATED if data[20] & _WEBP_ANIMATION else None)
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return Header((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
    width, height = struct.unpack_from("<HH", data, 26)
    return Header(width & 0x3FFF, height & 0x3FFF)


def gif_header(data: bytes) -> Header:
    """Header of a GIF; its animation is recognized by a second graphic control extension."""
    width, height = struct.unpack_from("<HH", data, 6)
    return Header(width, height, ANIMATED if data.count(_GIF_FRAME) > 1 else None)


def bmp_header(data: bytes) -> Header:
    """Header of a BMP."""
    form = "<HH" if data[14:18] == _OS2_HEAD else "<ii"
    width, height = struct.unpack_from(form, data, 18)
    return Header(width, abs(height))


def is_netpbm(data: bytes) -> bool:
    """Whether a file is a PBM, PGM or PPM."""
    return _NETPBM.match(data) is not None


def netpbm_header(data: bytes) -> Header:
    """Header of a PBM, PGM or PPM."""
    match = _NETPBM.match(data)
    if match is None:
        raise InputError("has no header of Netpbm")
    white = int(match[3]) if match[3] and not data.startswith(_BITMAPS) else None
    if white is not None and white <= _BYTE and data.startswith(_PLAIN):
        white = None  # the decoder scales these
    return Header(int(match[1]), int(match[2]), white=white)


IMAGE_SUFFIXES = (".jpg", ".png", ".tiff", ".webp", ".avif", ".bmp")  #: that OpenCV writes
# What OpenCV logs about a damaged file is raised as an error, with the name of the file.
getattr(cv2.utils, "logging", cv2).setLogLevel(0)  # OpenCV 4 has it in cv2 itself
_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
_GRAY_ALPHA, _WITH_ALPHA, _RANK_OF_COLOUR = 2, (2, 4), 3


def decode_with_opencv(data: bytes, *, has_alpha: bool = False, flags: int = _FLAGS) -> Decoded:
    """Pixels as the file stores them, and its EXIF; a further channel is alpha, or dropped."""
    pixels, _, metadata = cv2.imdecodeWithMetadata(np.frombuffer(data, np.uint8), flags=flags)
    if pixels is None or not pixels.size:
        raise InputError(
            "is damaged, or of a variant that cannot be decoded", "copy it again or convert it"
        )
    exif = metadata[0].tobytes() if len(metadata) else b""
    channels = pixels.shape[2] if pixels.ndim == _RANK_OF_COLOUR else 1
    alpha = pixels[..., -1] if has_alpha and channels in _WITH_ALPHA else None
    if channels <= _GRAY_ALPHA:
        colours = pixels.reshape(*pixels.shape[:2], channels)[..., 0]
    elif pixels.dtype in (np.uint8, np.uint16, np.float32):
        colours = cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)  # of four channels as well
    else:
        colours = pixels[..., 2::-1]
    return Decoded(colours, exif, alpha=alpha)


decode_gif = decode_webp = partial(decode_with_opencv, has_alpha=True)


def decode_bmp(data: bytes) -> Decoded:
    """Pixels of a BMP; those of OS/2 are gray if OpenCV is not asked for colours."""
    is_os2 = data[14:18] == _OS2_HEAD
    return decode_with_opencv(data, flags=cv2.IMREAD_COLOR if is_os2 else _FLAGS)


def decode_netpbm(data: bytes) -> Decoded:
    """Pixels of a PBM, PGM or PPM.

    OpenCV refuses texts that do not end in a line break, and takes the end of a header in CRLF for
    a pixel.
    """
    head = _NETPBM.match(data)
    end = head.end() if head else 0
    return decode_with_opencv(data[:end].replace(b"\r\n", b"\n") + data[end:] + b"\n")


def can_round_trip(suffix: str) -> bool:
    """Whether an image can be encoded and decoded in a format; the suffix has its dot."""
    try:
        ok, data = cv2.imencode(suffix, np.full((16, 16, 3), 128, np.uint8))
        return bool(ok) and cv2.imdecode(data, cv2.IMREAD_UNCHANGED) is not None
    except cv2.error:
        return False
