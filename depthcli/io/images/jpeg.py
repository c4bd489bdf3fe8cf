"""JPEG files: their segments (ITU-T T.81, annex B), and decoding them with libjpeg-turbo."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import simplejpeg

from depthcli.core import options, types
from depthcli.errors import InputError, Message
from depthcli.io.images import opencv, tiff

JPEG_START = b"\xff\xd8"
_FRAMES = frozenset(b"\xc0\xc1\xc2\xc3\xc5\xc6\xc7\xc9\xca\xcb\xcd\xce\xcf")
_SCAN, _APP1, _EXIF = 0xDA, 0xE1, b"Exif\0\0"
_STANDALONE = frozenset(b"\x01\xd0\xd1\xd2\xd3\xd4\xd5\xd6\xd7")
_FILLED_MARKER = re.compile(rb"\xff+([^\xff])", re.DOTALL)  # fill, however long, and the marker
_MULTI_PICTURE, _MP_ENTRIES, _DISPARITY = b"MPF\0", 0xB002, 0x020002
_OTHER_EYE = Message("holds an image for each eye, and the first is used", "{eye} chooses one")
_COLOURS = {1: "GRAY", 4: "CMYK"}  # by the number of components; others are decoded to RGB
# What libjpeg says of flaws that cost no pixel; anything else that it says is damage.
_PADDED = re.compile(r"(\d+) extraneous bytes before marker 0xd9")  # of some cameras and scanners
_SPECTRAL = "Invalid SOS parameters for sequential JPEG"  # phones of Samsung (OpenImageIO #2837)
_REVISION = "unknown JFIF revision number"
_JFIF = b"JFIF\0"
_WHOLE_SPECTRUM = bytes((0, 63, 0))


def jpeg_header(data: bytes) -> opencv.Header:
    """Size of a JPEG."""
    width, height, _ = _frame(data)
    indexes = (body[4:] for _, body in segments(data) if body.startswith(_MULTI_PICTURE))
    return opencv.Header(width, height, _OTHER_EYE if any(map(_stereo_offsets, indexes)) else None)


def _stereo_offsets(index: bytes) -> list[int]:
    """Where the image of each eye begins after an index of several (CIPA DC-007); left first.

    The first image of the file is at 0.
    """
    with suppress(struct.error, KeyError, ValueError):
        ((_, entries),) = tiff.read_tags(index, (_MP_ENTRIES,))
        order = "<" if index.startswith(b"I") else ">"
        items = list(struct.iter_unpack(order + "IIII", bytes(entries)))
        if any(kind & 0xFFFFFF == _DISPARITY for kind, *_ in items):
            return [offset for _, _, offset, _ in items]
    return []


def image_of_eye(data: bytes, eye: options.Eye) -> bytes:
    """The image of an eye in a JPEG of a stereo camera (MPO), as a file."""
    index_at = data.find(_MULTI_PICTURE) + len(_MULTI_PICTURE)
    offsets = _stereo_offsets(data[index_at:])
    at = index_at + offsets[1] if len(offsets) == len(options.Eye) else 0
    if not data.startswith(JPEG_START) or not data.startswith(JPEG_START, at) or not at:
        raise InputError("holds no image for each eye", "leave {eye} out, or separate them first")
    return data[at:] if eye is options.Eye.RIGHT else data


def exif_of_jpeg(data: bytes) -> bytes:
    """The EXIF of a JPEG, as ``parse_exif`` reads it; empty without one."""
    exifs = (body for marker, body in segments(data) if marker == _APP1 and body[:6] == _EXIF)
    return next(exifs, b"")


def decode_jpeg(data: bytes) -> opencv.Decoded:
    """Pixels of a JPEG; gray stays gray, and CMYK becomes RGB as in OpenCV."""
    colours = _COLOURS.get(_frame(data)[2], "RGB")
    try:
        pixels = _decode_strictly(data, colours)
    except ValueError as error:
        if "subsampling" not in str(error):
            raise InputError(f"is damaged ({error})", "copy it again") from error
        return opencv.decode_with_opencv(data)  # TurboJPEG has no name for it (zune-image #276)
    if colours == "CMYK":
        wide = pixels.astype(np.uint16)  # 255 is no ink, as Adobe's programs write it
        black = wide[..., 3:]
        pixels = (black - ((255 - wide[..., :3]) * black >> 8)).astype(np.uint8)
    return opencv.Decoded(pixels[..., 0] if colours == "GRAY" else pixels, exif_of_jpeg(data))


def _decode_strictly(data: bytes, colours: str) -> types.UInt8Array:
    """Pixels of a JPEG about which libjpeg says nothing, or nothing but a harmless flaw.

    The flaw is mended and the file decoded again, because the first warning hides all others, and
    after an error the array is whatever memory held. ValueError with the message otherwise.
    """
    try:
        pixels: types.UInt8Array = simplejpeg.decode_jpeg(data, colours)
    except ValueError as error:
        mended = _without_flaw(data, str(error))
        if mended == data:
            raise
        pixels = simplejpeg.decode_jpeg(mended, colours)
    return pixels


def _without_flaw(data: bytes, message: str) -> bytes:
    """A file without the harmless flaw of a message; unchanged if the message tells of damage."""
    scan = max((end for marker, _, end in _spans(data) if marker == _SCAN), default=len(data))
    if padding := _PADDED.search(message):
        end = data.find(b"\xff\xd9", scan)
        return data[: end - int(padding[1])] + data[end:]
    if _SPECTRAL in message:
        return data[: scan - len(_WHOLE_SPECTRUM)] + _WHOLE_SPECTRUM + data[scan:]
    if _REVISION in message:
        version = data.find(_JFIF) + len(_JFIF)
        return data[:version] + b"\1\1" + data[version + 2 :]
    return data


def _frame(data: bytes) -> tuple[int, int, int]:
    for marker, body in segments(data):
        if marker in _FRAMES:
            height, width, components = struct.unpack_from(">HHB", body, 1)
            return width, height, components
    raise InputError("is not an image, or a truncated JPEG", "copy it again")


def segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Marker and content of each segment before the pixels, up to the first invalid one."""
    for marker, start, end in _spans(data):
        if marker != _SCAN:
            yield marker, data[start + 2 : end]


def _spans(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, start and end of each segment, its length included, up to the first scan's header."""
    end, marker = len(JPEG_START), None
    while marker != _SCAN and (match := _FILLED_MARKER.match(data, end)):
        marker, start = match[1][0], match.end()
        end = start
        if marker not in _STANDALONE:
            end += int.from_bytes(data[start : start + 2], "big")
            yield marker, start, end
