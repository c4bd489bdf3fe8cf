"""Reading an image from a file, bytes, an array or PIL to an upright frame."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import transfer_warning
from depthcli.core.options import EXPOSURE, MAX_PIXELS, ReadOptions
from depthcli.core.types import Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.images.decode import CheckedImage, check, read_bytes
from depthcli.io.images.exif import EXIF_IFD, FOCAL_35MM, ORIENTATION, Exif, parse_exif
from depthcli.io.images.headers import Decoded
from depthcli.io.images.pixels import as_frame_dtype, check_white_level, full_range, upright
from depthcli.io.listing.own_outputs import EXR_MAGIC, is_own_exr
from depthcli.io.storage.paths import RemotePath, path_of

_GRAY_MODES = ("1", "LA")
_PLAIN_MODES = ("L", "RGB", "I", "F")  # Frame refuses unsupported pixels of the last two
_COLOUR_RANK = 3
_ALPHA = {2: 1, 4: 3}
"""Number of channels with alpha, to that without."""


def read_image(
    path: str | Path | None,
    data: bytes | None = None,
    *,
    max_pixels: int = MAX_PIXELS,
    name: str = "standard input",
    white_level: int | None = None,
    exposure: float = 0.0,
    layer: str | None = None,
) -> Frame:
    """Decode a picture at its own bit depth and undo its EXIF rotation.

    Alpha is dropped; gray stays gray. Linear light of an EXR is encoded by the sRGB curve, and its
    overscan is included (see ``Frame.windows``). In another float picture not-a-number and infinite
    pixels become 0 and the rest is clipped to [0, 1].

    Args:
        path: the file; with ``data``, only its name.
        data: the file's content, if it was read already (from standard input, for instance).
        max_pixels: pictures that claim more are refused before they are decoded.
        name: what messages call data without a path.
        white_level: value of white in a 16-bit picture, such as 4095 for data of 12 bits; it is
            scaled so that this is 65535. None for 65535, or what an AVIF, HEIC or Netpbm states.
        exposure: stops by which linear light of an EXR is brightened before it is clipped to white.
        layer: of an EXR, that is its picture, such as ``beauty``; None for that without a name,
            else the likeliest by its name.

    Returns:
        Gray (H, W) or RGB (H, W, 3); uint8, uint16 or float32.

    Raises:
        InputError: missing, empty, truncated, damaged, not a picture, too large, float with
            another range than [0, 1], or an EXR that depthcli wrote or without this layer.
        OutputError: there is no room for the temporary copy that the data of an EXR needs.
        UsageError: the white level is not a whole number from 1 to 65535, or the exposure is not
            from -20 to 20.
    """
    check_white_level(white_level)
    if not EXPOSURE.holds(exposure):
        raise UsageError(f"an exposure of {exposure!r} is not {EXPOSURE.what}")
    path = None if path is None else path_of(path)
    name = name if path is None else str(path)
    file = path if data is None else None
    if data is None:
        if path is None:
            raise InputError("neither a file nor data was given")
        data = read_bytes(path)
    if data.startswith(EXR_MAGIC):
        options = ReadOptions(exposure=exposure, layer=layer)
        return replace(_exr_picture(file, data, name, max_pixels, options), path=path)
    image = check(data, name, max_pixels)
    decoded = image.decode()
    exif, header = parse_exif(decoded.exif), image.header
    orientation = header.orientation or exif.orientation
    pixels, warnings = _frame_pixels(decoded, image, white_level, exposure)
    if not header.is_upright:
        pixels = upright(pixels, orientation)
    return Frame(
        np.ascontiguousarray(pixels),
        path,
        orientation=orientation,
        focal_35mm=exif.focal_35mm,
        warnings=tuple(filter(None, (header.warning, *warnings))),
    )


def _frame_pixels(
    decoded: Decoded, image: CheckedImage, white_level: int | None, exposure: float
) -> tuple[npt.NDArray[Any], tuple[str | None, ...]]:
    """Pixels of a frame, not turned yet, and warnings about them."""
    header, pixels = image.header, decoded.pixels
    if decoded.is_linear:
        from depthcli.io.exr.image import clip_warning, encode  # noqa: PLC0415 - loads OpenEXR

        light = pixels.reshape(*pixels.shape[:2], -1)
        above = encode(light, exposure)
        return light.reshape(pixels.shape), (clip_warning(above / light[..., 0].size),)
    pixels, warnings = full_range(pixels, header.white, white_level)
    hdr = transfer_warning(header.transfer, "picture", "sRGB")
    return as_frame_dtype(pixels, image.name), (*warnings, hdr)


def _exr_picture(
    file: Path | None,
    data: bytes,
    name: str,
    max_pixels: int,
    options: ReadOptions,
) -> Frame:
    """The picture in an EXR; of its data if there is no file, or none on this machine."""
    # Other pictures need not wait for it.
    from depthcli.io.exr.image import read_exr_data, read_exr_picture  # noqa: PLC0415

    if is_own_exr(data):
        raise InputError(
            f"{name} was written by depthcli; name a picture, or use 'depthcli convert' for depth "
            "files"
        )
    if file is None or isinstance(file, RemotePath):
        return read_exr_data(data, name, max_pixels, options)
    return read_exr_picture(file, max_pixels=max_pixels, options=options)


class ArrayLike(Protocol):
    """What NumPy converts to an array, such as a tensor in CPU memory."""

    def __array__(self) -> npt.NDArray[Any]:
        """The pixels."""


class PilPicture(Protocol):
    """The part of ``PIL.Image.Image`` that is used here."""

    def getexif(self) -> Any:  # noqa: ANN401 - PIL need not be installed
        """Its EXIF."""


Picture: TypeAlias = (
    str | os.PathLike[str] | bytes | bytearray | memoryview | ArrayLike | PilPicture | Frame
)
"""A path, the content of a file, pixels, or a PIL picture."""


def frame_of(picture: Picture, white_level: int | None = None) -> Frame:
    """A picture as a frame.

    Args:
        picture: a path; the content of a file; an RGB array or tensor (H, W) or (H, W, C) of
            uint8, uint16 or float32 in [0, 1], whose alpha is dropped; a PIL picture; a frame.
            Files, and PIL pictures that were opened from one, are rotated by their EXIF.
        white_level: value of white in 16-bit pixels, as for :func:`read_image`.

    Returns:
        The same frame, or a new one with a copy of the pixels.

    Raises:
        InputError: it is not a picture, or cannot be read.
        UsageError: the white level is not valid, or the picture is a frame, which has its own.
    """
    check_white_level(white_level)
    if isinstance(picture, Frame):
        if white_level is not None:
            raise UsageError(
                "a Frame is scaled to full range already; give white_level to read_image"
            )
        return picture
    if isinstance(picture, (str, os.PathLike)):
        return read_image(path_of(picture), white_level=white_level)
    if isinstance(picture, (bytes, bytearray, memoryview)):
        name = "the picture in memory"
        return read_image(None, bytes(picture), name=name, white_level=white_level)
    frame = _of_pil(picture) if hasattr(picture, "getexif") else Frame(_pixels(picture))
    pixels, warnings = full_range(frame.pixels, None, white_level)
    return replace(frame, pixels=pixels, warnings=warnings)


def _pixels(picture: ArrayLike) -> npt.NDArray[Any]:
    """A copy of the pixels: a camera may overwrite its buffer with the next picture."""
    try:
        # PyTorch's tensors warn if they are asked for a copy.
        pixels = np.array(np.asarray(picture), order="C")
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{type(picture).__name__} is not an array: {error}") from error
    if np.ma.is_masked(picture):
        raise InputError("a masked array has pixels without a value; fill them with .filled()")
    if pixels.ndim == 0 or pixels.dtype == object:
        raise InputError(
            "a picture is a path, bytes, an array, a Frame or a PIL picture, "
            f"not {type(picture).__name__}"
        )
    if pixels.ndim == _COLOUR_RANK and pixels.shape[2] in _ALPHA:
        pixels = pixels[..., : _ALPHA[pixels.shape[2]]]
    if pixels.ndim == _COLOUR_RANK and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    return np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("="))


def _of_pil(image: Any) -> Frame:  # noqa: ANN401 - PIL need not be installed
    try:
        pixels = _pixels(_gray_or_rgb(image))
    except OSError as error:
        raise InputError(f"the PIL picture cannot be read: {error}") from error
    if image.format is None:  # made or changed by a program: its EXIF may be outdated
        return Frame(pixels)
    exif = image.getexif()
    facts = Exif.of(exif.get(ORIENTATION), exif.get_ifd(EXIF_IFD).get(FOCAL_35MM))
    return Frame(
        np.ascontiguousarray(upright(pixels, facts.orientation)),
        Path(image.filename) if getattr(image, "filename", "") else None,
        orientation=facts.orientation,
        focal_35mm=facts.focal_35mm,
    )


def _gray_or_rgb(image: Any) -> Any:  # noqa: ANN401 - PIL need not be installed
    """The picture without a palette, alpha or other colours than RGB."""
    if image.mode in _GRAY_MODES:
        return image.convert("L")
    is_plain = image.mode in _PLAIN_MODES or image.mode.startswith("I;16")
    try:
        return image if is_plain else image.convert("RGB")
    except ValueError as error:
        raise InputError(
            f"a PIL picture of mode {image.mode} is not supported; convert it to RGB"
        ) from error
