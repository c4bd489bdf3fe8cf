"""Pixels in the form that a codec compresses."""

import numpy as np
import numpy.typing as npt
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace, Interpolation

from depthcli.video.codecs import DEPTH_PIXELS, ENCODINGS, Codec


def coded(pixels: npt.NDArray[np.uint16] | npt.NDArray[np.uint8], codec: Codec) -> VideoFrame:
    """Pixels, (H, W) uint16 for FFV1, else (H, W, 3) RGB uint8, as a codec takes them.

    For any thread. Where the codec halves the colours' rows and columns, an odd one is doubled.
    """
    wanted = ENCODINGS[codec].pixel_format
    if wanted == DEPTH_PIXELS:
        return VideoFrame.from_ndarray(np.ascontiguousarray(pixels, np.uint16), DEPTH_PIXELS)
    return VideoFrame.from_ndarray(_even(pixels), "rgb24").reformat(
        format=wanted,
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        dst_color_trc=None,
        interpolation=Interpolation.BICUBIC | Interpolation.ACCURATE_RND,
        threads=1,
    )


def _even(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.uint8]:
    height, width = pixels.shape[:2]
    if height % 2 or width % 2:
        pixels = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return np.ascontiguousarray(pixels, np.uint8)
