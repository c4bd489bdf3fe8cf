"""Conversions of a picture's colours for a network, at the picture's full precision."""

import cv2
import numpy as np
import numpy.typing as npt

_LUMA = np.array([[0.299, 0.587, 0.114]], np.float32)


def value_channel(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """V of HSV, the largest of R, G and B, (H, W) float32 in [0, 1]; gray is its own V.

    Pixels are (H, W) or (H, W, 3) RGB; uint8, uint16, or float32 in [0, 1].
    """
    if pixels.ndim == 2:  # noqa: PLR2004
        return unit(pixels)
    red, green, blue = cv2.split(pixels)  # type: ignore[arg-type]
    return unit(cv2.max(cv2.max(red, green), blue))


def luma(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """Rec. 601 luma of the coded values; arguments and result as in :func:`value_channel`."""
    if pixels.ndim == 2:  # noqa: PLR2004
        return unit(pixels)
    gray = np.asarray(cv2.transform(unit(pixels), _LUMA), np.float32)
    return gray.reshape(pixels.shape[:2])


def brightness(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """Luma to the precision of the pixels' own type, which is much faster than :func:`luma`."""
    if pixels.ndim == 2:  # noqa: PLR2004
        return unit(pixels)
    return unit(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))  # type: ignore[arg-type]


def rgb(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """Three channels (H, W, 3) float32 in [0, 1]; gray is repeated."""
    values = unit(pixels)
    return values if values.ndim == 3 else np.repeat(values[..., None], 3, axis=2)  # noqa: PLR2004


def unit(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """Coded values of any shape as float32 in [0, 1]."""
    if pixels.dtype == np.float32:
        return np.clip(pixels, 0, 1)
    top = 255 if pixels.dtype == np.uint8 else 65535
    return pixels.astype(np.float32) * np.float32(1 / top)
