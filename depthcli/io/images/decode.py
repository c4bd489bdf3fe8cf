"""Reading image files: what each is, what its header states, and its pixels.

Every container is a row of one table: how it is recognized, read and decoded.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy.typing as npt

from depthcli.core.options import MAX_PIXELS, check_pixel_count
from depthcli.errors import InputError, is_out_of_memory
from depthcli.io.images import headers, isobmff
from depthcli.io.images.headers import Decoded, Header
from depthcli.io.images.heif import decode_heif, heif_header
from depthcli.io.images.jpeg import JPEG_START, decode_jpeg, jpeg_header
from depthcli.io.images.opencv import decode_with_opencv
from depthcli.io.images.openimageio import (
    decode_with_openimageio,
    is_for_openimageio,
    openimageio_header,
)
from depthcli.io.images.png import SIGNATURE, png_header, still_image
from depthcli.io.images.tiff import TIFF_STARTS, decode_tiff, tiff_header
from depthcli.io.listing.folder import CAMERA_RAW, is_video
from depthcli.io.listing.own_outputs import EXR_MAGIC
from depthcli.io.storage.paths import RemotePath, read_regular

MAX_FILE_BYTES = 2**32
"""More than an image of ``MAX_PIXELS`` takes in float32 RGB."""
OPENCV_MAX_PIXELS = 2**30
_MAX_SIDE = 1_000_000  # libpng and OpenCV decode no longer ones


class _Container(NamedTuple):
    """A kind of image files."""

    recognizes: Callable[[bytes], bool]
    header: Callable[[bytes], Header]
    decode: Callable[[bytes], Decoded]


def _starting(*starts: bytes) -> Callable[[bytes], bool]:
    return lambda data: data.startswith(starts)


_CONTAINERS = (
    _Container(_starting(JPEG_START), jpeg_header, decode_jpeg),
    _Container(
        _starting(SIGNATURE), png_header, lambda data: decode_with_opencv(still_image(data))
    ),
    _Container(_starting(*TIFF_STARTS), tiff_header, decode_tiff),
    _Container(isobmff.is_heif, heif_header, decode_heif),
    _Container(isobmff.is_avif, isobmff.avif_header, decode_with_opencv),
    _Container(
        lambda data: data[:4] == b"RIFF" and data[8:12] == b"WEBP",
        headers.webp_header,
        decode_with_opencv,
    ),
    _Container(_starting(b"GIF87a", b"GIF89a"), headers.gif_header, decode_with_opencv),
    _Container(_starting(b"BM"), headers.bmp_header, decode_with_opencv),
    _Container(headers.is_netpbm, headers.netpbm_header, decode_with_opencv),
    _Container(is_for_openimageio, openimageio_header, decode_with_openimageio),
)


class CheckedImage(NamedTuple):
    """An image file that was found to be one of an allowed size, not decoded yet."""

    data: bytes
    name: str  #: in messages
    header: Header
    container: _Container

    def decode(self) -> Decoded:
        """Decode its pixels.

        Raises:
            InputError: truncated, damaged, or too large for the memory.
        """
        with _errors_about(self.name):
            return self.container.decode(self.data)


def read_bytes(path: Path, first: int = -1) -> bytes:
    """Content of an input file, or its ``first`` bytes.

    Raises:
        InputError: it is missing, a folder, a pipe, a device, unreadable, too large, or a link that
            leads nowhere.
    """
    try:
        return read_regular(path, MAX_FILE_BYTES, first=first)
    except FileNotFoundError as error:
        if isinstance(path, RemotePath):
            raise InputError(f"{path} cannot be read: {error.strerror}") from None
        what = "is a broken link" if path.is_symlink() else "is missing: no such file"
        raise InputError(f"{path} {what}") from None
    except IsADirectoryError:
        raise InputError(
            f"{path} is a folder", "name the files in it, or give it to 'depthcli batch'"
        ) from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def check(data: bytes, name: str, max_pixels: int = MAX_PIXELS) -> CheckedImage:
    """Check an image by its header, without decoding it.

    Args:
        data: the whole file: JPEG, PNG, TIFF, WebP, AVIF, HEIC, BMP, GIF or Netpbm; with
            OpenImageIO also DPX, Cineon, Radiance HDR, PSD, JPEG XL, JPEG 2000 and Targa.
        name: what messages call it.
        max_pixels: images that claim more are refused.

    Raises:
        InputError: empty, truncated, not an image, too large, or in need of an extra.
    """
    if not data:
        raise InputError(f"{name} is empty")
    if data.startswith(TIFF_STARTS) and name.lower().endswith(CAMERA_RAW):
        raise InputError(f"{name} is a camera raw file", "convert it to JPEG, PNG or TIFF first")
    container = _container_of(data)
    if container is None:
        raise _no_image(data, name)
    with _errors_about(name):
        header = container.header(data)
    width, height = header.width, header.height
    if width <= 0 or height <= 0:
        raise InputError(f"{name} claims {width}×{height} pixels", "the picture is empty")
    check_pixel_count(name, width, height, max_pixels)
    if max(width, height) > _MAX_SIDE:
        raise InputError(
            f"{name} has {width}×{height} pixels, and no side may be longer than {_MAX_SIDE:,}",
            "divide it",
        )
    return CheckedImage(data, name, header, container)


def decode(data: bytes, name: str, *, max_pixels: int = MAX_PIXELS) -> npt.NDArray[Any]:
    """Pixels of an image at its own bit depth, as :func:`check` has its arguments and errors.

    Returns:
        Gray (H, W) or RGB (H, W, 3), alpha dropped, of the file's own type, as stored. TIFF, HEIC
        and what OpenImageIO reads are already turned upright.
    """
    return check(data, name, max_pixels).decode().pixels


def image_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that a file states; None if it is not an image or its header is damaged."""
    container = _container_of(data)
    try:
        header = container.header(data) if container else None
    except (InputError, struct.error, LookupError):
        return None
    return (header.width, header.height) if header else None


def _container_of(data: bytes) -> _Container | None:
    return next((one for one in _CONTAINERS if one.recognizes(data)), None)


def _no_image(data: bytes, name: str) -> InputError:
    """Message for a file of another kind."""
    if data.startswith(EXR_MAGIC):  # here, where only other formats are decoded
        return InputError(f"{name} is an EXR", "end its name in .exr, or save it as PNG or TIFF")
    advice = "'depthcli video' reads videos" if is_video(name) else ""
    return InputError(
        f"{name} is not a picture (JPEG, PNG, TIFF, WebP, AVIF, HEIC, BMP, GIF, PNM, EXR)", advice
    )


@contextmanager
def _errors_about(name: str) -> Iterator[None]:
    """Name the file in errors of a container's reader."""
    try:
        yield
    except InputError as error:
        message = error.message
        raise InputError(f"{name} {message.problem}", message.advice) from error
    except (cv2.error, struct.error, ValueError, LookupError, MemoryError) as error:
        if is_out_of_memory(error):
            raise InputError(f"{name} does not fit into memory", "make it smaller") from error
        raise InputError(
            f"{name} is truncated or damaged", "copy it again or convert it"
        ) from error
