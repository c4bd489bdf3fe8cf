"""A video file that is being written."""

from __future__ import annotations

import shutil
from enum import StrEnum
from typing import TYPE_CHECKING

import cv2
import numpy as np

from depthcli.errors import OutputError
from depthcli.io.ffmpeg_log import silent_ffmpeg
from depthcli.io.mkv_finish import OPENCV_RATE, finish_mkv
from depthcli.io.mp4_finish import finish_mp4, opencv_rate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    import numpy.typing as npt

    _Pixels = npt.NDArray[np.uint16 | np.uint8]

_CHECK_EVERY = 32
_LEAST_FREE_BYTES = 1 << 20


class Codec(StrEnum):
    """How frames are compressed; the value is the code of four letters."""

    FFV1 = "FFV1"
    """Lossless, (H, W) uint16, in Matroska."""
    MPEG4 = "mp4v"
    """Lossy, (H, W, 3) RGB uint8, in MP4; every build of OpenCV with FFmpeg has it."""


class VideoFile:
    """Frames of one size, written one after the other.

    OpenCV cuts odd sizes to even ones, so an odd row or column is doubled; labels keep the size.
    """

    def __init__(self, path: Path, codec: Codec, rate: Fraction) -> None:
        """Prepare a file; it is opened with the first frame.

        Args:
            path: straight as it is; callers make it atomic. Ends in ``.mkv`` or ``.mp4``.
            codec: how frames are compressed.
            rate: frames a second.
        """
        self._path = path
        self._codec = codec
        self._rate = rate
        self._writer: cv2.VideoWriter | None = None
        self._size = (0, 0)
        self._frames = 0

    def write(self, pixels: _Pixels) -> None:
        """Append a frame of the codec's type.

        Raises:
            OutputError: the file cannot be opened, or the disk is full.
        """
        if self._writer is None:
            self._size = (pixels.shape[1], pixels.shape[0])
            self._writer = self._opened()
        if self._frames % _CHECK_EVERY == 0:
            self._check_disk()
        even = _even(pixels)
        with silent_ffmpeg():
            self._writer.write(even if even.ndim == 2 else cv2.cvtColor(even, cv2.COLOR_RGB2BGR))  # noqa: PLR2004
        self._frames += 1

    def finish(self, times_s: Sequence[float], labels: Mapping[str, str]) -> None:
        """Close the file, see that all of it is there, and give it exact times.

        Args:
            times_s: of each frame from the first, in seconds.
            labels: name -> text, kept in Matroska.

        Raises:
            OutputError: frames are missing in the file: the disk is full, say.
            OSError: the file cannot be read or written.
        """
        self.close()
        try:
            if self._codec is Codec.FFV1:
                width, height = self._size
                size = {"width": str(width), "height": str(height)}
                finish_mkv(self._path, self._rate, times_s, {**size, **labels})
            else:
                finish_mp4(self._path, self._rate, times_s)
        except ValueError as error:
            raise OutputError(
                f"the {self._path.suffix} file was not written whole ({error}); "
                "is the disk full? choose another --out"
            ) from error

    def close(self) -> None:
        """Let the file go, finished or not."""
        if self._writer is not None:
            with silent_ffmpeg():
                self._writer.release()
            self._writer = None

    def _opened(self) -> cv2.VideoWriter:
        width, height = (n + n % 2 for n in self._size)
        gray = self._codec is Codec.FFV1
        options = [
            *(cv2.VIDEOWRITER_PROP_IS_COLOR, int(not gray)),
            *(cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U if gray else cv2.CV_8U),
        ]
        code = cv2.VideoWriter.fourcc(*self._codec.value)
        try:
            name = str(self._path).encode().decode()
        except UnicodeEncodeError as error:  # OpenCV would crash
            raise OutputError(
                f"{self._path} is not UTF-8, which a video's name has to be; choose another --out, "
                "or files with --format png16 or --format exr"
            ) from error
        self._path.touch()  # what is wrong with the folder is said by the system, not by OpenCV
        with silent_ffmpeg():
            writer = cv2.VideoWriter(
                name,
                cv2.CAP_FFMPEG,
                code,
                OPENCV_RATE if gray else opencv_rate(self._rate),
                (width, height),
                options,
            )
        if not writer.isOpened():
            raise OutputError(
                f"{self._codec.value} video of {width}×{height} pixels cannot be written here; "
                "choose an image sequence with --format png16 or --format exr"
            )
        return writer

    def _check_disk(self) -> None:
        """OpenCV does not say that a frame could not be written."""
        if shutil.disk_usage(self._path.parent).free < _LEAST_FREE_BYTES:
            raise OutputError(f"the disk of {self._path.parent} is full; choose another --out")


def _even(pixels: _Pixels) -> _Pixels:
    """Pixels with the last row and column doubled where their number is odd."""
    height, width = pixels.shape[:2]
    if height % 2 == width % 2 == 0:
        return np.ascontiguousarray(pixels)
    rest = ((0, 0),) * (pixels.ndim - 2)
    return np.pad(pixels, ((0, height % 2), (0, width % 2), *rest), mode="edge")
