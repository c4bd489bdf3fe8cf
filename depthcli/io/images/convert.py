"""Converting a path, bytes, an array or an image of PIL to a frame."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from depthcli.core.types import Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.images.exif import EXIF_IFD, FOCAL_35MM, ORIENTATION, Exif
from depthcli.io.images.pixels import check_white_level, full_range, upright
from depthcli.io.images.read import read_image
from depthcli.io.storage.paths import path_of

_GRAY_MODES = ("1", "LA")
_PLAIN_MODES = ("L", "RGB", "I", "F")  # Frame refuses unsupported pixels of the last two
_COLOUR_RANK = 3
_ALPHA = {2: 1, 4: 3}
"""Number of channels with alpha, to that without."""


class ArrayLike(Protocol):
    """Objects that NumPy converts to an array, such as a tensor in CPU memory."""

    def __array__(self) -> npt.NDArray[Any]:
        """The pixels."""


class PilPicture(Protocol):
    """The part of ``PIL.Image.Image`` that is used here."""

    def getexif(self) -> Any:  # noqa: ANN401 - PIL need not be installed
        """Its EXIF."""


Picture: TypeAlias = (
    str | os.PathLike[str] | bytes | bytearray | memoryview | ArrayLike | PilPicture | Frame
)
"""A path, the content of a file, pixels, or a PIL image."""


def frame_of(image: Picture, white_level: int | None = None) -> Frame:
    """An image as a frame.

    Args:
        image: a path; the content of a file; an RGB array or tensor (H, W) or (H, W, C) of
            uint8, uint16 or float32 in [0, 1], whose alpha is dropped; a PIL image; a frame.
            Files, and PIL images that were opened from one, are rotated by their EXIF.
        white_level: value of white in 16-bit pixels, as for :func:`read_image`.

    Returns:
        The same frame, or a new one with a copy of the pixels.

    Raises:
        InputError: it is not an image, or cannot be read.
        UsageError: the white level is not valid, or the image is a frame, which has its own.
    """
    check_white_level(white_level)
    if isinstance(image, Frame):
        if white_level is not None:
            raise UsageError(
                "a Frame is scaled to full range already; give white_level to read_image"
            )
        return image
    if isinstance(image, (str, os.PathLike)):
        return read_image(path_of(image), white_level=white_level)
    if isinstance(image, (bytes, bytearray, memoryview)):
        name = "the picture in memory"
        return read_image(None, bytes(image), name=name, white_level=white_level)
    frame = _of_pil(image) if hasattr(image, "getexif") else Frame(_pixels(image))
    pixels, warnings = full_range(frame.pixels, None, white_level)
    return replace(frame, pixels=pixels, warnings=warnings)


def _pixels(image: ArrayLike) -> npt.NDArray[Any]:
    """A copy of the pixels: a camera may overwrite its buffer with the next image."""
    try:
        # PyTorch's tensors warn if they are asked for a copy.
        pixels = np.array(np.asarray(image), order="C")
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{type(image).__name__} is not an array: {error}") from error
    if np.ma.is_masked(image):
        raise InputError("a masked array has pixels without a value; fill them with .filled()")
    if pixels.ndim == 0 or pixels.dtype == object:
        raise InputError(
            "a picture is a path, bytes, an array, a Frame or a PIL picture, "
            f"not {type(image).__name__}"
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
    """The image without a palette, alpha or other colours than RGB."""
    if image.mode in _GRAY_MODES:
        return image.convert("L")
    is_plain = image.mode in _PLAIN_MODES or image.mode.startswith("I;16")
    try:
        return image if is_plain else image.convert("RGB")
    except ValueError as error:
        raise InputError(
            f"a PIL picture of mode {image.mode} is not supported; convert it to RGB"
        ) from error
