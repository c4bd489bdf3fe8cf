"""Converting a path, bytes, an array or a PIL picture to a frame."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from depthcli.core.types import Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.pictures.exif import EXIF_IFD, FOCAL_35MM, ORIENTATION, plausible_focal
from depthcli.io.pictures.levels import check_white_level, full_range
from depthcli.io.pictures.read import read_image, upright
from depthcli.io.storage.remote import path_of

_GRAY_MODES = ("1", "LA")
_PLAIN_MODES = ("L", "RGB", "I", "F")  # Frame refuses unsupported pixels of the last two
_COLOUR_RANK = 3
_ALPHA = {2: 1, 4: 3}
"""Number of channels with alpha, to that without."""


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
    pixels, warnings = full_range(frame.pixels, b"", white_level)
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
    orientation, focal_35mm = exif.get(ORIENTATION), exif.get_ifd(EXIF_IFD).get(FOCAL_35MM)
    orientation = orientation if orientation in range(2, 9) else 1
    return Frame(
        np.ascontiguousarray(upright(pixels, orientation)),
        Path(image.filename) if getattr(image, "filename", "") else None,
        orientation=orientation,
        focal_35mm=plausible_focal(focal_35mm),
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
