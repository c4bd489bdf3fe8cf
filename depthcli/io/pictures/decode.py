"""Decoding a picture file to pixels, after checks of untrusted files."""

import re
import struct
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.choices import MAX_PIXELS
from depthcli.core.extras import INSTALL_HEIF
from depthcli.core.picture_limit import PictureLimit
from depthcli.errors import InputError, is_out_of_memory
from depthcli.io.listing.folder import is_video
from depthcli.io.listing.heif import reads_heif
from depthcli.io.listing.own_outputs import EXR_MAGIC
from depthcli.io.listing.skipped import CAMERA_RAW, convert_to
from depthcli.io.pictures.decoder_messages import decoder_messages
from depthcli.io.pictures.heif import is_heif
from depthcli.io.pictures.integrity import find_problem
from depthcli.io.pictures.size import is_os2, picture_size
from depthcli.io.pictures.tiff import TIFF_STARTS, has_thumbnail_only, with_colours_as_stored
from depthcli.io.png.chunks import static_image
from depthcli.io.storage.regular import read_regular
from depthcli.io.storage.remote import RemotePath

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


def decode(
    data: bytes, name: str, *, max_pixels: int | PictureLimit = MAX_PIXELS
) -> npt.NDArray[np.generic]:
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


def check(data: bytes, name: str, max_pixels: int | PictureLimit = MAX_PIXELS) -> None:
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
    check_size(name, width, height, max_pixels)
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


def check_size(name: str, width: int, height: int, max_pixels: int | PictureLimit) -> None:
    """Refuse a picture that is too large, before any of it is decoded.

    Raises:
        InputError: it is.
    """
    PictureLimit.of(max_pixels).check(name, width, height)


def _without_alpha(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    channels = pixels.shape[2] if pixels.ndim == _RGB else 1
    if channels in (1, _GRAY_ALPHA):
        return pixels.reshape(*pixels.shape[:2], channels)[..., 0]
    if pixels.dtype in (np.uint8, np.uint16, np.float32):
        return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)  # type: ignore[arg-type] # four as well
    return pixels[..., 2::-1]
