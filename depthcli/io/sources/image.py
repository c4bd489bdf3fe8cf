"""One picture, from a file or from bytes, to a frame that stands upright."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from depthcli.core.types import Frame
from depthcli.errors import InputError
from depthcli.io.exif import read_exif
from depthcli.io.picture_header import picture_size, truncation

if TYPE_CHECKING:
    import numpy.typing as npt

MAX_PIXELS = 250_000_000
_GRAY_ALPHA, _RGB, _RGBA = 2, 3, 4
_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION


def read_image(
    path: str | Path | None, data: bytes | None = None, *, max_pixels: int = MAX_PIXELS
) -> Frame:
    """Decode a picture at its own bit depth and undo its EXIF rotation.

    Alpha is dropped; gray stays gray; not-a-number and infinite pixels of a float picture become 0
    and floats are clipped to [0, 1].

    Args:
        path: the file; with ``data``, only its name.
        data: the file's content, where it is already at hand (standard input, say).
        max_pixels: pictures that claim more are refused before they are decoded.

    Returns:
        Gray (H, W) or RGB (H, W, 3); uint8, uint16 or float32.

    Raises:
        InputError: missing, empty, truncated, not a picture, or too large.
    """
    path = None if path is None else Path(path)
    if data is None:
        if path is None:
            raise InputError("neither a file nor data was given")
        data = read_bytes(path)
    name = str(path) if path else "standard input"
    _check(data, name, max_pixels)
    exif = read_exif(data)
    pixels = _turned(_colours(_decoded(data, name), name), exif.orientation)
    return Frame(pixels, path, orientation=exif.orientation, focal_35mm=exif.focal_35mm)


def read_bytes(path: Path) -> bytes:
    """Content of an input file.

    Raises:
        InputError: it is missing, a folder, unreadable, or a link that leads nowhere.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        broken = path.is_symlink()
        raise InputError("is a broken link" if broken else "no such file") from None
    except IsADirectoryError:
        raise InputError("is a folder; use `depthcli batch` for folders") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}") from None


def _check(data: bytes, name: str, max_pixels: int) -> None:
    if not data:
        raise InputError(f"{name} is empty")
    size = picture_size(data)
    if size is not None:
        width, height = size
        if width <= 0 or height <= 0:
            raise InputError(f"{name} claims {width}×{height} pixels; there is nothing to see")
        if width * height > max_pixels:
            raise InputError(
                f"{name} claims {width}×{height} pixels, more than {max_pixels:,}; "
                "raise --max-pixels if it is genuine"
            )
    missing = truncation(data)
    if missing:
        raise InputError(f"{name} is truncated ({missing}); copy it again")


def _decoded(data: bytes, name: str) -> npt.NDArray[np.generic]:
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), _FLAGS)
    except cv2.error:
        pixels = None
    if pixels is None or pixels.size == 0:
        raise InputError(f"{name} is not a picture that can be decoded (JPEG, PNG, TIFF, WebP, …)")
    return pixels


def _colours(pixels: npt.NDArray[np.generic], name: str) -> npt.NDArray[np.generic]:
    """OpenCV's channel orders to gray or RGB, and its types to the three of a frame."""
    channels = pixels.shape[2] if pixels.ndim == _RGB else 1
    if channels in (1, _GRAY_ALPHA):
        pixels = pixels.reshape(*pixels.shape[:2], channels)[..., 0]
    elif channels in (_RGB, _RGBA):
        code = cv2.COLOR_BGR2RGB if channels == _RGB else cv2.COLOR_BGRA2RGB
        pixels = cv2.cvtColor(pixels, code)  # type: ignore[arg-type]
    else:
        raise InputError(f"{name} has {channels} channels; give gray or colour")
    if pixels.dtype in (np.uint8, np.uint16):
        return np.ascontiguousarray(pixels)
    if pixels.dtype in (np.float32, np.float64):
        finite = np.nan_to_num(pixels.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        return np.clip(finite, 0, 1)
    raise InputError(f"{name} has {pixels.dtype} pixels; save it with 8 or 16 bits or as float")


_MIRRORED = {2, 4, 5, 7}
_QUARTER_TURNS = {3: 2, 4: 2, 5: 1, 6: 3, 7: 3, 8: 1}


def _turned(pixels: npt.NDArray[Any], orientation: int) -> npt.NDArray[Any]:
    """Undo an EXIF orientation: mirror along the rows, then turn counter-clockwise."""
    if orientation in _MIRRORED:
        pixels = pixels[:, ::-1]
    pixels = np.rot90(pixels, _QUARTER_TURNS.get(orientation, 0))
    return np.ascontiguousarray(pixels)
