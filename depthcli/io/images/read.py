"""Reading images: what each file is, what its header states, and its pixels as a frame.

Every container is a row of one table: how it is recognized, read and decoded.
"""

import os
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO, NamedTuple, Protocol, TypeAlias

import cv2
import numpy as np

from depthcli.core import options
from depthcli.core.camera import Intrinsics
from depthcli.core.imageops import PANORAMA, transfer_warning
from depthcli.core.types import AnyArray, Frame
from depthcli.errors import InputError, Message, UsageError, is_out_of_memory
from depthcli.io.exr.image import clip_warning, encode, read_exr_image
from depthcli.io.images import heif, jpeg, opencv, openimageio, png, tiff
from depthcli.io.images.pixels import (
    as_frame_dtype,
    check_levels,
    fill_transparent,
    from_video_range,
    full_range,
    upright,
)
from depthcli.io.media import CAMERA_RAW, EXR_MAGIC, SOFTWARE_KEY, is_video
from depthcli.io.storage.paths import path_of, read_bytes

OPENCV_MAX_PIXELS = 2**30
_XMP_BYTES = 2**20  # at both ends of a file, in which its XMP is looked for
_LIGHT = Message(
    "its floats are taken as encoded for display, as in sRGB",
    "if they are linear light, save them as EXR",
)
_DAMAGE = (  # what decoders raise about it, those of HEIF whatever Python has
    *(cv2.error, struct.error, ValueError, LookupError, MemoryError),
    *(EOFError, OSError, RuntimeError, SyntaxError, zlib.error),
)
_GPANO = re.compile(rb"GPano:(\w+)\W{1,4}(\w+)")


class _Container(NamedTuple):
    """A kind of image files, with a module of functions.

    They are called ``is_KIND``, ``KIND_header`` and ``decode_KIND``, and raise InputError, without
    the name of the file, and what the decoder raises about damaged ones. ``decode_KIND`` returns
    no pixel that its decoder did not write: what this reports after the header is damage, except
    for texts known to be harmless, and where it reports nothing, the file is checked before. A
    test damages files of each kind (docs/decisions/008-headers-of-images.md).
    """

    kind: str
    module: ModuleType
    starts: tuple[bytes, ...] = ()  #: of its files; none for one that ``is_KIND`` recognizes

    def call(self, function: str, data: bytes) -> Any:  # noqa: ANN401 - as the function returns it
        """Whether a file is of this kind, its ``Header``, or what it is ``Decoded`` to."""
        return getattr(self.module, function.format(self.kind))(data)


_CONTAINERS = (
    _Container("jpeg", jpeg, (b"\xff\xd8",)),
    _Container("png", png, (png.SIGNATURE,)),
    _Container("tiff", tiff, tiff.TIFF_STARTS),
    _Container("webp", opencv),
    _Container("gif", opencv, (b"GIF87a", b"GIF89a")),
    _Container("bmp", opencv, (b"BM",)),
    _Container("netpbm", opencv),
    _Container("heif", heif),
    _Container("avif", heif),
    _Container("openimageio", openimageio),
)


class CheckedImage(NamedTuple):
    """An image file that was found to be one of an allowed size, not decoded yet."""

    data: bytes
    name: str  #: in messages
    header: opencv.Header
    container: _Container

    def decode(self) -> opencv.Decoded:
        """Decode its pixels."""
        with reader_errors(self.name):
            decoded: opencv.Decoded = self.container.call("decode_{}", self.data)
        return decoded


def check(data: bytes, name: str, max_pixels: int = options.MAX_PIXELS) -> CheckedImage:
    """Check an image, whose file is ``data``, by its header, without decoding it."""
    if not data:
        raise InputError(f"{name} is empty")
    if data.startswith(tiff.TIFF_STARTS) and name.lower().endswith(CAMERA_RAW):
        raise InputError(f"{name} is a camera raw file", "convert it to JPEG, PNG or TIFF first")
    for container in _CONTAINERS:
        starts = container.starts
        if data.startswith(starts) if starts else container.call("is_{}", data):
            break
    else:
        advice = "'depthcli video' reads videos" if is_video(name) else ""
        if data.startswith(EXR_MAGIC):  # here, where only other formats are decoded
            raise InputError(f"{name} is an EXR", "end its name in .exr, or save it as PNG or TIFF")
        formats = "JPEG, PNG, TIFF, WebP, AVIF, HEIC, BMP, GIF, PNM, EXR"
        raise InputError(f"{name} is not an image ({formats})", advice)
    with reader_errors(name):
        header = container.call("{}_header", data)
    if min(header.width, header.height) <= 0:
        raise InputError(f"{name} claims {header.width}×{header.height} pixels", "it is empty")
    options.check_pixel_count(name, header.width, header.height, max_pixels)
    return CheckedImage(data, name, header, container)


@contextmanager
def reader_errors(name: str) -> Iterator[None]:
    """Raise errors of a container's reader as an InputError that names the file."""
    try:
        yield
    except InputError as error:
        message = error.message
        raise InputError(f"{name} {message.problem}", message.advice) from error
    except _DAMAGE as error:
        if is_out_of_memory(error):
            raise InputError(f"{name} does not fit into memory", "make it smaller") from error
        raise InputError(
            f"{name} is truncated or damaged", "copy it again or convert it"
        ) from error


def read_image(
    path: str | Path | None,
    data: bytes | None = None,
    *,
    max_pixels: int = options.MAX_PIXELS,
    name: str = "standard input",
    white_level: int | None = None,
    exposure: float = 0.0,
    layer: str | None = None,
    projection: options.Projection | None = None,
    ignore_alpha: bool = False,
    black_level: int = 0,
    eye: options.Eye | None = None,
) -> Frame:
    """Decode an image at its own bit depth and undo its EXIF rotation.

    Transparent pixels are filled with colours around them, except those of an EXR; gray stays gray.
    Linear light of an EXR is encoded by the sRGB curve, and its overscan is included (see
    ``Frame.windows``). In another float image not-a-number and infinite pixels become 0 and the
    rest is clipped to [0, 1].

    Args:
        path: the file; with ``data``, only its name.
        data: the file's content, if it was read already (from standard input, for instance).
        max_pixels: images that claim more are refused before they are decoded.
        name: what messages call data without a path.
        white_level: value of white in a 16-bit image, such as 4095 for data of 12 bits; it is
            scaled so that this is 65535. None for 65535, or what an AVIF, HEIC or Netpbm states.
        exposure: stops by which linear light of an EXR is brightened before it is clipped to white.
        layer: of an EXR, that is its image, such as ``beauty``; None for that without a name,
            else the likeliest by its name.
        projection: how directions became its pixels; None for a pinhole camera.
        ignore_alpha: whether transparent pixels are as good as others.
        black_level: value of black in a 16-bit image, which becomes 0.
        eye: of a JPEG with an image for each (MPO); None for the first.

    Returns:
        Gray (H, W) or RGB (H, W, 3); uint8, uint16 or float32.

    Raises:
        InputError: missing, empty, truncated, damaged, not an image, too large, float with
            another range than [0, 1], written by depthcli, or an EXR without this layer.
        UsageError: a level is not a whole number of 16 bits, black is not below white, or the
            exposure is not from -20 to 20.
    """
    check_levels(white_level, black_level)
    if not options.EXPOSURE.holds(exposure):
        raise UsageError(f"an exposure of {exposure!r} is not {options.EXPOSURE.what}")
    path = None if path is None else path_of(path)
    name = name if path is None else str(path)
    if data is None:
        if path is None:
            raise InputError("neither a file nor data was given")
        data = read_bytes(path)
    if eye is not None:
        with reader_errors(name):
            data = jpeg.image_of_eye(data, eye)
    if data.startswith((EXR_MAGIC, png.SIGNATURE, b"P5")) and SOFTWARE_KEY.encode() in data[:4096]:
        raise InputError(f"{name} was written by depthcli", "name the image that it was made of")
    if data.startswith(EXR_MAGIC):
        reading = options.ReadOptions(exposure=exposure, layer=layer, projection=projection)
        frame = read_exr_image(data, name=name, max_pixels=max_pixels, options=reading)
        return replace(frame, path=path)
    image = check(data, name, max_pixels)
    decoded = image.decode()
    exif, header = tiff.parse_exif(decoded.exif), image.header
    orientation = header.orientation or exif.orientation
    levels = white_level, black_level
    pixels, warnings = _frame_pixels(decoded, image, levels, exposure)
    if not header.is_upright:
        pixels = upright(pixels, orientation)
    facts = _GPANO.findall(data[:_XMP_BYTES]) or _GPANO.findall(data[-_XMP_BYTES:])
    xmp: dict[bytes, bytes] = dict(reversed(facts))  # an element's end follows its value
    is_panorama = b"ProjectionType" in xmp and projection is None  # or cylindrical
    whole = xmp.get(b"FullPanoWidthPixels", b"")
    part = xmp.get(b"CroppedAreaImageWidthPixels", whole)
    if projection == options.Projection.EQUIRECTANGULAR and part != whole:
        warning = f"{name} shows {part.decode()} of the {whole.decode()} columns of a panorama"
        raise InputError(warning, "give a whole one")
    doubts = PANORAMA if is_panorama else None, tiff.profile_warning(header.profile or data)
    of_eyes = header.warning if eye is None else None
    frame = Frame(
        np.ascontiguousarray(pixels),
        path,
        orientation=orientation,
        focal_35mm=exif.focal_35mm,
        focal_mm=exif.focal_mm,
        warnings=tuple(filter(None, (of_eyes, *warnings, *doubts))),
        pixel_aspect=decoded.pixel_aspect,
        projection=projection or options.Projection.PINHOLE,
    )
    if decoded.alpha is None or ignore_alpha:
        return frame
    alpha = decoded.alpha if header.is_upright else upright(decoded.alpha, orientation)
    with reader_errors(name):
        return masked(frame, alpha)


def masked(frame: Frame, alpha: AnyArray) -> Frame:
    """The frame without what is transparent in it."""
    filled = fill_transparent(frame.pixels, alpha)
    if filled is None:
        return frame
    pixels, hidden = filled
    problem = f"{hidden.mean():.0%} of the pixels are transparent and get no depth"
    warning = Message(problem, "give {ignore_alpha} to use their colours")
    return replace(frame, pixels=pixels, transparent=hidden, warnings=(*frame.warnings, warning))


def undistorted(frame: Frame, camera: Intrinsics) -> Frame:
    """An image as a pinhole of the same matrix takes it, if its camera says so.

    Pixels that the lens does not show are transparent.
    """
    lens = camera.distortion
    if lens is None or not camera.is_undistorted:
        return frame
    if frame.windows is not None or not lens.coefficients:
        raise InputError("its distortion cannot be removed", "rectify the images first")
    scale = 1 if camera.size_px is None else frame.width / camera.size_px[0]
    matrix = np.diag([*np.multiply(lens.focal_px, scale), 1])
    matrix[:2, 2] = camera.centre_for(frame.width, frame.height)
    undistort = cv2.fisheye.undistortImage if lens.is_fisheye else cv2.undistort
    target = matrix, np.array(lens.coefficients), None, matrix
    hidden = np.zeros(frame.pixels.shape[:2]) if frame.transparent is None else frame.transparent
    alpha = undistort(np.where(hidden, np.uint8(0), np.uint8(255)), *target)
    pixels: AnyArray = undistort(frame.pixels, *target)
    pixels, transparent = fill_transparent(pixels, alpha) or (pixels, None)
    return replace(frame, pixels=pixels, transparent=transparent)


def _frame_pixels(
    decoded: opencv.Decoded, image: CheckedImage, levels: tuple[int | None, int], exposure: float
) -> tuple[AnyArray, tuple[str | None, ...]]:
    """Pixels of a frame, not turned yet, and warnings about them."""
    header, pixels = image.header, decoded.pixels
    if decoded.is_linear:
        light = pixels.reshape(*pixels.shape[:2], -1)
        above = encode(light, exposure)
        return light.reshape(pixels.shape), (clip_warning(above / light[..., 0].size),)
    warnings: tuple[str, ...] = ()
    if decoded.is_limited and pixels.ndim < _COLOUR_RANK:
        pixels = from_video_range(pixels, header.white)
    else:
        pixels, warnings = full_range(pixels, header.white, *levels)
    hdr = transfer_warning(header.transfer, "image", "sRGB")
    linear = _LIGHT if pixels.dtype.kind == "f" and b"acsp" not in image.data else None
    return as_frame_dtype(pixels, image.name), (*warnings, hdr, linear)


_ALPHA_MODES = ("La", "PA", "RGBa")
# Frame refuses unsupported pixels of the last two.
_PLAIN_MODES = ("L", "LA", "RGB", "RGBA", "I", "F")
_COLOUR_RANK = 3
_ALPHA = {2: 1, 4: 3}  # number of channels with alpha, to that without


class ArrayLike(Protocol):
    """Objects that NumPy converts to an array, such as a tensor in CPU memory."""

    def __array__(self) -> AnyArray:
        """The pixels."""


class PilImage(Protocol):
    """The part of ``PIL.Image.Image`` that is used here."""

    def getexif(self) -> Any:  # noqa: ANN401 - PIL need not be installed
        """Its EXIF."""


_Content: TypeAlias = bytes | bytearray | memoryview | BinaryIO
#: a path, a file's content, a file open for reading, pixels, or a PIL image
ImageLike: TypeAlias = str | os.PathLike[str] | _Content | ArrayLike | PilImage | Frame


def frame_of(image: ImageLike, white_level: int | None = None) -> Frame:
    """An image as a frame.

    Args:
        image: a path or URI; the content of a file; a file open for reading; an RGB array or
            tensor (H, W) or (H, W, C) of uint8, uint16 or floats in [0, 1], or with alpha; a PIL
            image; a frame.
            Files, and PIL images that were opened from one, are rotated by their EXIF.
        white_level: value of white in 16-bit pixels, as for :func:`read_image`.

    Returns:
        The same frame, or a new one with a copy of the pixels.

    Raises:
        InputError: it is not an image, or cannot be read.
        UsageError: the white level is not valid, or the image is a frame, which has its own.
    """
    check_levels(white_level)
    if isinstance(image, Frame):
        if white_level is not None:
            raise UsageError(
                "a Frame is scaled to full range already; give white_level to read_image"
            )
        return image
    if isinstance(image, (str, os.PathLike)):
        return read_image(path_of(image), white_level=white_level)
    if hasattr(image, "read"):
        image = image.read()
    if isinstance(image, (bytes, bytearray, memoryview)):
        name = "the image in memory"
        return read_image(None, bytes(image), name=name, white_level=white_level)
    if hasattr(image, "getexif"):
        frame, alpha = _of_pil(image)
    else:
        array, alpha = _pixels(image)
        frame = Frame(array)
    pixels, warnings = full_range(frame.pixels, None, white_level)
    frame = replace(frame, pixels=pixels, warnings=warnings)
    return frame if alpha is None else masked(frame, alpha)


def _pixels(image: ArrayLike) -> tuple[AnyArray, AnyArray | None]:
    """A copy of the pixels, as a camera may overwrite its buffer with the next image; and alpha."""
    try:
        # PyTorch's tensors warn if they are asked for a copy.
        pixels = np.array(np.asarray(image), order="C")
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{type(image).__name__} is not an array: {error}") from error
    if pixels.dtype.kind == "f":
        pixels = pixels.astype(np.float32, copy=False)
    if pixels.ndim == 0 or pixels.dtype == object:  # None of cv2.imread, for instance
        problem = "an image is a path, bytes, an array, a Frame or a PIL image"
        raise InputError(f"{problem}, not {type(image).__name__}")
    alpha = None
    if pixels.ndim == _COLOUR_RANK and pixels.shape[2] in _ALPHA:
        alpha = pixels[..., -1]
        pixels = pixels[..., : _ALPHA[pixels.shape[2]]]
    if pixels.ndim == _COLOUR_RANK and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    return np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("=")), alpha


def _of_pil(image: Any) -> tuple[Frame, AnyArray | None]:  # noqa: ANN401 - PIL need not be installed
    with reader_errors("the PIL image"):
        pixels, alpha = _pixels(_gray_or_rgb(image))
    if image.format is None:  # made or changed by a program: its EXIF may be outdated
        return Frame(pixels), alpha
    exif = image.getexif()
    facts = tiff.Exif.of({**exif.get_ifd(tiff.EXIF_IFD), **exif})
    frame = Frame(
        np.ascontiguousarray(upright(pixels, facts.orientation)),
        Path(image.filename) if getattr(image, "filename", "") else None,
        orientation=facts.orientation,
        focal_35mm=facts.focal_35mm,
        focal_mm=facts.focal_mm,
    )
    return frame, None if alpha is None else upright(alpha, facts.orientation)


def _gray_or_rgb(image: Any) -> Any:  # noqa: ANN401 - PIL need not be installed
    """The image without a palette or other colours than RGB, with its alpha."""
    if image.mode == "1":
        return image.convert("L")
    if image.mode in _ALPHA_MODES or "transparency" in image.info:
        return image.convert("RGBA")
    is_plain = image.mode in _PLAIN_MODES or image.mode.startswith("I;16")
    return image if is_plain else image.convert("RGB")
