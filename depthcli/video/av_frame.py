"""Converting pixels to PyAV frames in the pixel format of a codec."""

import numpy as np
import numpy.typing as npt
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace, Interpolation

from depthcli.video.codecs import DEPTH_PIXELS, ENCODINGS, Codec


def av_frame(pixels: npt.NDArray[np.uint16] | npt.NDArray[np.uint8], codec: Codec) -> VideoFrame:
    """A PyAV frame in the pixel format of a codec; thread-safe.

    Pixels are (H, W) uint16 for FFV1, else (H, W, 3) RGB uint8. For codecs with chroma subsampling,
    an odd row or column is doubled.
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
