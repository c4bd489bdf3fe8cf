"""The RGB pixels of a decoded frame at full precision, and its orientation."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from av.sidedata.sidedata import Type
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace, Interpolation, VideoReformatter

from depthcli.core.transfer import transfer_warning

_INTERLACED = (
    "the video is interlaced, and the network sees both fields of a frame at once; for better "
    "depth, deinterlace it first: ffmpeg -i in.mov -vf yadif -c:v ffv1 out.mkv"
)
_EIGHT_BIT = 8
_UNSPECIFIED = 2
_SD_ROWS = 576
_TOLERANCE = 0.02
_IDENTITY = (1, 0, 0, 1)
_EXIF_OF_MATRIX = {
    _IDENTITY: 1,
    (-1, 0, 0, 1): 2,
    (-1, 0, 0, -1): 3,
    (1, 0, 0, -1): 4,
    (0, 1, 1, 0): 5,
    (0, 1, -1, 0): 6,
    (0, -1, -1, 0): 7,
    (0, -1, 1, 0): 8,
}
_EXIF_OF_ANGLE = {90: 8, 180: 3, 270: 6}  # in degrees, counter-clockwise


def rgb_pixels(
    frame: VideoFrame, reformatter: VideoReformatter
) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
    """A frame converted to RGB from its own colour space and range, not rotated.

    If it states no colour space, that is BT.601 up to 576 rows and BT.709 above, as in players.

    Returns:
        (H, W, 3) RGB: uint8 of 8-bit video, else uint16, scaled to 0-65535.

    Raises:
        av.FFmpegError: the format cannot be converted.
    """
    is_deep = any(component.bits > _EIGHT_BIT for component in frame.format.components)
    guessed = Colorspace.ITU709 if frame.height > _SD_ROWS else Colorspace.ITU601
    rgb = reformatter.reformat(
        frame,
        format="rgb48le" if is_deep else "rgb24",
        src_colorspace=guessed if frame.colorspace == _UNSPECIFIED else None,
        dst_color_range=ColorRange.JPEG,
        interpolation=Interpolation.BICUBIC,
    )
    return rgb.to_ndarray()  # type: ignore[return-value]


def orientation_of(frame: VideoFrame) -> int:
    """The EXIF orientation (1-8) of a frame's display matrix; 1 for other angles."""
    try:
        side_data: Any = frame.side_data  # whose type is stated wrongly
        data = side_data.get(Type.DISPLAYMATRIX)
    except ValueError:  # PyAV does not know all kinds, as that of EXIF, beside the matrix
        return _EXIF_OF_ANGLE.get(frame.rotation % 360, 1)
    if data is None:
        return 1
    a, b, _, c, d = np.frombuffer(bytes(data), "<i4")[:5].tolist()
    across, down = math.hypot(a, c) or 1, math.hypot(b, d) or 1  # the matrix may scale as well
    shares = a / across, b / down, c / across, d / down
    turns = (turn for turn in _EXIF_OF_MATRIX if np.allclose(shares, turn, atol=_TOLERANCE))
    return _EXIF_OF_MATRIX[next(turns, _IDENTITY)]


def picture_warnings(first: VideoFrame) -> Iterator[str]:
    """Warnings about what the network sees, by the first frame of a video."""
    warnings = (
        transfer_warning(first.color_trc, "video", "BT.709"),
        _INTERLACED if first.interlaced_frame else None,
    )
    return filter(None, warnings)
