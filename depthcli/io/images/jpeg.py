"""JPEG files: their segments (ITU-T T.81, annex B), and decoding them with libjpeg-turbo."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import simplejpeg

from depthcli.core.arrays import UInt8Array
from depthcli.core.options import Eye
from depthcli.errors import InputError, Message
from depthcli.io.images.opencv import Decoded, Header, decode_with_opencv
from depthcli.io.images.tiff import read_tags

JPEG_START = b"\xff\xd8"
_FRAMES = frozenset(b"\xc0\xc1\xc2\xc3\xc5\xc6\xc7\xc9\xca\xcb\xcd\xce\xcf")
_SCAN, _APP1, _EXIF = 0xDA, 0xE1, b"Exif\0\0"
_STANDALONE = frozenset(b"\x01\xd0\xd1\xd2\xd3\xd4\xd5\xd6\xd7")
_FILLED_MARKER = re.compile(rb"\xff+([^\xff])", re.DOTALL)  # fill, however long, and the marker
_MULTI_PICTURE, _MP_ENTRIES, _DISPARITY = b"MPF\0", 0xB002, 0x020002
_OTHER_EYE = Message("holds an image for each eye, and the first is used", "{eye} chooses one")
_COLOURS = {1: "GRAY", 4: "CMYK"}  # by the number of components; others are decoded to RGB
# After such messages of libjpeg pixels are made up. Other warnings are harmless, above all that of
# extraneous bytes before the end (0xd9), which some cameras write.
_DATA_LOSS = re.compile(
    r"premature end|bad Huffman code|bad arithmetic code|instead of RST"
    r"|extraneous bytes before marker 0x(?:c4|da|d[0-7])",
    re.IGNORECASE,
)


def jpeg_header(data: bytes) -> Header:
    """Size of a JPEG."""
    width, height, _ = _frame(data)
    indexes = (body[4:] for _, body in segments(data) if body.startswith(_MULTI_PICTURE))
    return Header(width, height, _OTHER_EYE if any(map(_stereo_offsets, indexes)) else None)


def _stereo_offsets(index: bytes) -> list[int]:
    """Where the image of each eye begins after an index of several (CIPA DC-007); left first.

    The first image of the file is at 0.
    """
    with suppress(struct.error, KeyError, ValueError):
        ((_, entries),) = read_tags(index, (_MP_ENTRIES,))
        order = "<" if index.startswith(b"I") else ">"
        found = list(struct.iter_unpack(order + "IIII", bytes(entries)))
        if any(kind & 0xFFFFFF == _DISPARITY for kind, *_ in found):
            return [offset for _, _, offset, _ in found]
    return []


def image_of_eye(data: bytes, eye: Eye) -> bytes:
    """The image of an eye in a JPEG of a stereo camera (MPO), as a file."""
    index_at = data.find(_MULTI_PICTURE) + len(_MULTI_PICTURE)
    offsets = _stereo_offsets(data[index_at:])
    at = index_at + offsets[1] if len(offsets) == len(Eye) else 0
    if not data.startswith(JPEG_START) or not data.startswith(JPEG_START, at) or not at:
        raise InputError("holds no image for each eye", "leave {eye} out, or separate them first")
    return data[at:] if eye is Eye.RIGHT else data


def exif_of_jpeg(data: bytes) -> bytes:
    """The EXIF of a JPEG, as ``parse_exif`` reads it; empty without one."""
    exifs = (body for marker, body in segments(data) if marker == _APP1 and body[:6] == _EXIF)
    return next(exifs, b"")


def decode_jpeg(data: bytes) -> Decoded:
    """Pixels of a JPEG; gray stays gray, and CMYK becomes RGB as in OpenCV."""
    colours = _COLOURS.get(_frame(data)[2], "RGB")
    exif = exif_of_jpeg(data)
    try:
        pixels: UInt8Array = simplejpeg.decode_jpeg(data, colours)
    except ValueError as error:
        if "subsampling" in str(error):  # TurboJPEG has no name for it
            return decode_with_opencv(data)
        if _DATA_LOSS.search(str(error)):
            raise InputError(f"is damaged ({error})", "copy it again") from error
        pixels = simplejpeg.decode_jpeg(data, colours, strict=False)
    if colours == "CMYK":
        pixels = _rgb_of_inverted_cmyk(pixels)
    return Decoded(pixels[..., 0] if colours == "GRAY" else pixels, exif)


def _rgb_of_inverted_cmyk(cmyk: UInt8Array) -> UInt8Array:
    """(H, W, 3) of (H, W, 4), in which 255 is no ink, as Adobe's programs write it."""
    wide = cmyk.astype(np.uint16)
    black = wide[..., 3:]
    return (black - ((255 - wide[..., :3]) * black >> 8)).astype(np.uint8)


def _frame(data: bytes) -> tuple[int, int, int]:
    for marker, body in segments(data):
        if marker in _FRAMES:
            height, width, components = struct.unpack_from(">HHB", body, 1)
            return width, height, components
    raise InputError("is not an image, or a truncated JPEG", "copy it again")


def segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Marker and content of each segment before the pixels, up to the first invalid one."""
    at = len(JPEG_START)
    while (found := _FILLED_MARKER.match(data, at)) and found[1][0] != _SCAN:
        at = found.end()
        if found[1][0] not in _STANDALONE:
            length = int.from_bytes(data[at : at + 2], "big")
            yield found[1][0], data[at + 2 : at + length]
            at += length
