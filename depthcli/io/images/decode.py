"""Decoding a picture file to pixels, after checks of untrusted files."""

import re
import struct
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import row_bands
from depthcli.core.options import EXPOSURE, MAX_PIXELS, WHITE_LEVEL, check_pixel_count
from depthcli.core.text import INSTALL_HEIF
from depthcli.errors import InputError, UsageError, is_out_of_memory
from depthcli.io.images.isobmff import avif_size, heif_problem, heif_size, is_heif
from depthcli.io.images.jpeg import JPEG_START, has_jpeg_end, jpeg_segments
from depthcli.io.images.native_log import decoder_messages
from depthcli.io.images.png import SIGNATURE, read_chunks, static_image
from depthcli.io.images.tiff import (
    TIFF_STARTS,
    has_thumbnail_only,
    tiff_bits,
    tiff_directories,
    tiff_problem,
    tiff_size,
    with_colours_as_stored,
)
from depthcli.io.images.webp import riff_chunks
from depthcli.io.listing.folder import CAMERA_RAW, convert_to, is_video, reads_heif
from depthcli.io.listing.own_outputs import EXR_MAGIC
from depthcli.io.storage.paths import RemotePath, read_regular

_JPEG_SIZES = frozenset(b"\xc0\xc1\xc2\xc3\xc5\xc6\xc7\xc9\xca\xcb\xcd\xce\xcf")
_NUMBER = rb"\s+(?:#[^\n]*\n\s*)*(\d{1,9})"
NETPBM = re.compile(rb"P[1-6]" + 2 * _NUMBER + rb"(?:" + _NUMBER + rb")?\s")
"""Width, height and, except for bitmaps, the maximum value."""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that a file of a known picture format states; None for other files."""
    try:
        return _size_of_kind(data)
    except (struct.error, IndexError):
        return None


def _size_of_kind(data: bytes) -> tuple[int, int] | None:
    if data.startswith(SIGNATURE):
        return struct.unpack_from(">II", data, 16)
    if data.startswith(JPEG_START):
        frame = next((body for marker, body in jpeg_segments(data) if marker in _JPEG_SIZES), b"")
        height, width = struct.unpack_from(">HH", frame, 1)
        return width, height
    if data.startswith(b"BM"):
        width, height = struct.unpack_from("<HH" if is_os2(data) else "<ii", data, 18)
        return width, abs(height)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    if data.startswith(TIFF_STARTS):
        return tiff_size(data)
    if data[4:8] == b"ftyp":
        return heif_size(data) if is_heif(data) else avif_size(data)
    if data.startswith((b"GIF87a", b"GIF89a")):
        return struct.unpack_from("<HH", data, 6)
    netpbm = NETPBM.match(data)
    return (int(netpbm[1]), int(netpbm[2])) if netpbm else None


def is_os2(data: bytes) -> bool:
    """Whether it is a BMP with the header of OS/2."""
    return data.startswith(b"BM") and data[14:18] == b"\x0c\0\0\0"


def _webp(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8X":
        width = int.from_bytes(data[24:27], "little") + 1
        return width, int.from_bytes(data[27:30], "little") + 1
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None


_GIF_STARTS = (b"GIF87a", b"GIF89a")
_GIF_IMAGE, _GIF_EXTENSION, _GIF_TABLE = 0x2C, 0x21, 0x80


def count_warnings(data: bytes) -> tuple[str, ...]:
    """A warning about a TIFF of several pages or an animated picture; empty for others.

    Args:
        data: a whole file that can be decoded.
    """
    if data[4:12] == b"ftypavis":
        return ("is an animated AVIF; only the first picture is used",)
    count = _picture_count(data)
    return (f"has {count} pictures; only the first is used",) if count > 1 else ()


def _picture_count(data: bytes) -> int:
    count = 0
    try:
        if data.startswith(TIFF_STARTS):
            for is_picture in tiff_directories(data):
                count += is_picture or not count
        elif data.startswith(SIGNATURE):
            heads = (body for kind, body, _ in read_chunks(data) if kind == b"acTL")
            count = int.from_bytes(next(heads, b"")[:4], "big")
        elif data[:4] == b"RIFF" and data[12:16] == b"VP8X":
            count = sum(kind == b"ANMF" for kind, _ in riff_chunks(data))
        elif data.startswith(_GIF_STARTS):
            at = 13 + _gif_table_bytes(data[10])
            while data[at] in (_GIF_IMAGE, _GIF_EXTENSION):
                is_image = data[at] == _GIF_IMAGE
                count += is_image
                at += 11 + _gif_table_bytes(data[at + 9]) if is_image else 2
                while data[at]:
                    at += data[at] + 1
                at += 1
    except (struct.error, IndexError):  # decoders, too, pass over what follows the first picture
        pass
    return count


def _gif_table_bytes(flags: int) -> int:
    """Size of a colour table, by the flags before it."""
    return 6 << (flags & 7) if flags & _GIF_TABLE else 0


_ANCILLARY = 0x20  # set in the kind's first letter: decoders may do without the chunk
_BMP_HEAD, _BMP_CORE = 14, 12  # bytes: before the header proper, and of that of OS/2
_BMP_BGR = struct.pack("<III", 0xFF0000, 0xFF00, 0xFF)


def find_problem(data: bytes) -> str | None:
    """A problem of a JPEG's or HEIF's end, a PNG's chunks, a TIFF or a BMP; None without one.

    The decoders of other formats report damage themselves.

    Args:
        data: the whole file.
    """
    if data.startswith(JPEG_START):
        return None if has_jpeg_end(data) else "is truncated (its end is missing); copy it again"
    if data.startswith(SIGNATURE):
        return _png_problem(data)
    if data.startswith(TIFF_STARTS):
        return tiff_problem(data)
    if is_heif(data):
        return heif_problem(data)
    return _bmp_problem(data) if data.startswith(b"BM") else None


def _bmp_problem(data: bytes) -> str | None:
    """OpenCV would read pixels from the header, and assumes the usual order of 32-bit channels."""
    start, size = struct.unpack_from("<II", data, 10)
    if start < _BMP_HEAD + size:
        return "is damaged (the pixels of the BMP begin within its header); save it again"
    bits, coding = struct.unpack("<HI", data[28:34].ljust(6, b"\0"))
    if size > _BMP_CORE and (bits, coding) == (32, 3) and data[54:66] != _BMP_BGR:
        return "has an unusual order of colours in a BMP of 32 bits; save it as PNG"
    return None


def _png_problem(data: bytes) -> str | None:
    for kind, body, checksum in read_chunks(data):
        if not kind[0] & _ANCILLARY and zlib.crc32(body, zlib.crc32(kind)) != checksum:
            return "is damaged (a checksum of the PNG is wrong); copy it again"
        if kind == b"IEND":
            return None
    return "is truncated (its end is missing); copy it again"


MAX_FILE_BYTES = 2**32
"""More than a picture of ``MAX_PIXELS`` takes in float32 RGB."""
OPENCV_MAX_PIXELS = 2**30
_MAX_SIDE = 1_000_000  # libpng and OpenCV decode no longer ones
_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
_OS2_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION  # else its colours become gray
# After such messages of libjpeg or libtiff, pixels are made up. Extraneous bytes before a JPEG's
# end (0xd9) are harmless.
_DATA_LOSS = re.compile(
    rb"premature end|bad Huffman code|bad arithmetic code|instead of RST"
    rb"|extraneous bytes before marker 0x(?:c4|da|d[0-7])|TIFF_Error|PackBitsDecode: Discarding",
    re.IGNORECASE,
)
_GRAY_ALPHA, _RGB = 2, 3


def read_bytes(path: Path) -> bytes:
    """Content of an input file.

    Raises:
        InputError: it is missing, a folder, a pipe, a device, unreadable, too large, or a link that
            leads nowhere.
    """
    try:
        return read_regular(path, MAX_FILE_BYTES)
    except FileNotFoundError as error:
        if isinstance(path, RemotePath):
            raise InputError(f"{path} cannot be read: {error.strerror}") from None
        what = "is a broken link" if path.is_symlink() else "is missing: no such file"
        raise InputError(f"{path} {what}") from None
    except IsADirectoryError:
        raise InputError(
            f"{path} is a folder; name the files in it, or give it to 'depthcli batch'"
        ) from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def decode(data: bytes, name: str, *, max_pixels: int = MAX_PIXELS) -> npt.NDArray[np.generic]:
    """Pixels at the file's own bit depth, in stored order of rows and columns.

    Args:
        data: the whole file: JPEG, PNG, TIFF, WebP, AVIF, BMP, GIF or Netpbm.
        name: what messages call it.
        max_pixels: pictures that claim more are refused before they are decoded.

    Returns:
        Gray (H, W) or RGB (H, W, 3), alpha dropped, of the file's own type. TIFF alone is already
        turned upright, because OpenCV's reader always does so.

    Raises:
        InputError: empty, truncated, damaged, not a picture, or too large, also for the memory.
    """
    check(data, name, max_pixels)
    try:
        pixels = decoded(static_image(data), _OS2_FLAGS if is_os2(data) else _FLAGS)
    except cv2.error as error:
        if is_out_of_memory(error):
            raise InputError(f"{name} does not fit into memory; make it smaller") from error
        pixels = None
    if pixels is None:
        raise InputError(
            f"{name} is damaged, or of a variant that cannot be decoded; save it again"
        )
    return _without_alpha(pixels)


def decoded(data: bytes, flags: int) -> npt.NDArray[np.generic] | None:
    """Pixels as OpenCV decodes them, (H, W) or (H, W, C), without output on standard error.

    None if the file is not a picture, or the decoder filled in missing pixels.

    Raises:
        cv2.error: the decoder failed.
    """
    if data.startswith(TIFF_STARTS):
        data = with_colours_as_stored(data)
    with decoder_messages() as messages:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    return None if pixels is None or pixels.size == 0 or _DATA_LOSS.search(messages) else pixels


def _why_no_picture(data: bytes, name: str) -> str:
    """What a file of another kind is, and what to do with it."""
    if data.startswith(EXR_MAGIC):  # here, where only other formats are decoded
        return "is an EXR; end its name in .exr, or save it as PNG or TIFF"
    formats = convert_to(name)
    convert = f"; convert it to {formats} first" if formats else ""
    advice = "; 'depthcli video' reads videos" if is_video(name) else convert
    return f"is not a picture (JPEG, PNG, TIFF, WebP, AVIF, HEIC, BMP, GIF, PNM, EXR){advice}"


def check(data: bytes, name: str, max_pixels: int = MAX_PIXELS) -> None:
    """Check a picture without decoding it.

    Raises:
        InputError: empty, truncated, not a picture, too large, or HEIC without pillow-heif.
    """
    if not data:
        raise InputError(f"{name} is empty")
    if is_heif(data) and not reads_heif():
        raise InputError(f"{name} is HEIC, which needs pillow-heif; {INSTALL_HEIF}")
    if data.startswith(TIFF_STARTS):
        _check_no_raw(data, name)
    size = picture_size(data)
    if size is None:
        raise InputError(f"{name} {_why_no_picture(data, name)}")
    width, height = size
    if width <= 0 or height <= 0:
        raise InputError(f"{name} claims {width}×{height} pixels; the picture is empty")
    check_pixel_count(name, width, height, max_pixels)
    if max(width, height) > _MAX_SIDE:
        raise InputError(
            f"{name} has {width}×{height} pixels, and no side may be longer than {_MAX_SIDE:,}; "
            "divide it"
        )
    found = find_problem(data)
    if found is not None:
        raise InputError(f"{name} {found}")


def _check_no_raw(data: bytes, name: str) -> None:
    what = "is a camera raw file" if name.lower().endswith(CAMERA_RAW) else None
    with suppress(struct.error):  # the check of its size tells
        if what is None and has_thumbnail_only(data):
            what = "has a thumbnail as its first picture, as camera raw files do"
    if what is not None:
        raise InputError(f"{name} {what}; convert it to JPEG, PNG or TIFF first")


def _without_alpha(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    channels = pixels.shape[2] if pixels.ndim == _RGB else 1
    if channels in (1, _GRAY_ALPHA):
        return pixels.reshape(*pixels.shape[:2], channels)[..., 0]
    if pixels.dtype in (np.uint8, np.uint16, np.float32):
        return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)  # type: ignore[arg-type] # four as well
    return pixels[..., 2::-1]


PICTURE_SUFFIXES = (".jpg", ".png", ".tiff", ".webp", ".avif", ".bmp")
"""One suffix for each format that is read as a picture."""


def can_round_trip(suffix: str) -> bool:
    """Whether a picture can be encoded and decoded in a format; the suffix has its dot."""
    picture = np.full((16, 16, 3), 128, np.uint8)
    try:
        ok, data = cv2.imencode(suffix, picture)
        return bool(ok) and cv2.imdecode(data, cv2.IMREAD_UNCHANGED) is not None
    except cv2.error:
        return False


_BITMAPS, _PLAIN = (b"P1", b"P4"), (b"P2", b"P3")
_CONFIGURATION = re.compile(rb"av1C\x81.(.)", re.DOTALL)
_HIGH, _TWELVE = 0x40, 0x20
_MIN_BITS, _MAX_BITS = 8, 16  # between them, TIFF is packed
_MAX = {np.dtype(np.uint8): 0xFF, np.dtype(np.uint16): 0xFFFF}
_SENSOR_WHITES = {0x3FF: 10, 0xFFF: 12}
"""Bits of the data whose white this is."""
_CLIPPED_SHARE = 1e-4


def full_range(
    pixels: npt.NDArray[Any], data: bytes, white_level: int | None = None
) -> tuple[npt.NDArray[Any], tuple[str, ...]]:
    """Pixels scaled so that white is the maximum of their type.

    Args:
        pixels: as they were decoded, of any type.
        data: the file; empty for pixels of a program.
        white_level: value of white in 16-bit pixels, from 1 to 65535, unless the file itself
            states one below 65535; None for what it states.

    Returns:
        The pixels, and warnings about them, one line each.
    """
    top = _MAX.get(pixels.dtype)
    if top is None:
        return pixels, ()
    stated = _stated_white(data)
    if stated is not None and stated < top:
        is_scaled = pixels.itemsize == 1 and data.startswith(_PLAIN)  # by the decoder itself
        return (pixels if is_scaled else scaled(pixels, stated)), ()
    if pixels.dtype != np.uint16:
        return pixels, ()
    if white_level is None:
        return pixels, _white_warnings(pixels)
    return scaled(pixels, white_level), _clip_warnings(pixels, white_level)


def check_white_level(white_level: int | None) -> None:
    """Check the value of white.

    Raises:
        UsageError: it is not a whole number from 1 to 65535.
    """
    is_number = isinstance(white_level, int | np.integer)
    if white_level is not None and not (is_number and WHITE_LEVEL.holds(white_level)):
        raise UsageError(f"a white level of {white_level!r} is not {WHITE_LEVEL.what}")


def check_exposure(stops: float) -> None:
    """Check an exposure.

    Raises:
        UsageError: it is not a number from -20 to 20.
    """
    if not EXPOSURE.holds(stops):
        raise UsageError(f"an exposure of {stops!r} is not {EXPOSURE.what}")


def scaled(pixels: npt.NDArray[Any], white: int) -> npt.NDArray[Any]:
    """Pixels of 8 or 16 bits times their maximum over ``white``; larger ones become white."""
    top = _MAX[pixels.dtype]
    levels = np.rint(np.minimum(np.arange(top + 1), white) * top / white).astype(pixels.dtype)
    found = np.empty_like(pixels)
    height, width = pixels.shape[:2]
    for rows in row_bands(width, height):  # indexing takes several times the memory of the pixels
        found[rows] = levels[pixels[rows]]
    return found


def _stated_white(data: bytes) -> int | None:
    """The value of white in an AVIF, Netpbm or packed TIFF; None if it is that of its type."""
    if data.startswith(TIFF_STARTS):
        bits = tiff_bits(data)
        # The decoder shifts them to the left.
        return (1 << _MAX_BITS) - (1 << _MAX_BITS - bits) if _MIN_BITS < bits < _MAX_BITS else None
    if data[4:8] == b"ftyp":
        found = _CONFIGURATION.search(data)
        flags = found[1][0] if found else 0
        return None if not flags & _HIGH else 0xFFF if flags & _TWELVE else 0x3FF
    netpbm = NETPBM.match(data)
    has_white = netpbm and netpbm[3] and not data.startswith(_BITMAPS)
    return int(netpbm[3]) if netpbm and has_white else None


def _white_warnings(pixels: npt.NDArray[Any]) -> tuple[str, ...]:
    """A warning about 16-bit pixels that are clipped at the white of a sensor of 10 or 12 bits.

    Dark pictures do not end in a plateau at exactly this value, so they give none.
    """
    white = int(pixels.max())
    bits = _SENSOR_WHITES.get(white)
    if bits is None or np.count_nonzero(pixels == white) < _CLIPPED_SHARE * pixels.size:
        return ()
    bright = f"its brightest pixels are {white} of 65535, as in data of {bits} bits"
    return (f"{bright}; if that is white, give --white-level {white}",)


def _clip_warnings(pixels: npt.NDArray[Any], white_level: int) -> tuple[str, ...]:
    brightest = int(pixels.max())
    if brightest <= white_level:
        return ()
    return (
        f"has pixels up to {brightest}, above the white level of {white_level}; they are white",
    )
