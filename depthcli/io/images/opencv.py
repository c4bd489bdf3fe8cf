"""Decoding images with OpenCV, which stays silent."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.errors import InputError
from depthcli.io.images.headers import Decoded

IMAGE_SUFFIXES = (".jpg", ".png", ".tiff", ".webp", ".avif", ".bmp")
"""One suffix for each format that OpenCV reads and writes."""
MAX_PIXELS_OF_OPENCV = 2**30
_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
_SILENT = 0
_GRAY_ALPHA, _RANK_OF_COLOUR = 2, 3


class _Silence:
    """OpenCV's log level, which all threads share."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = self._level = 0

    def _change_users(self, by: int) -> None:
        log = getattr(cv2.utils, "logging", cv2)  # OpenCV 4 has these in cv2 itself
        with self._lock:
            if not self._users:
                self._level = log.getLogLevel()
                log.setLogLevel(_SILENT)
            self._users += by
            if not self._users:
                log.setLogLevel(self._level)

    @contextmanager
    def __call__(self) -> Iterator[None]:
        self._change_users(1)
        try:
            yield
        finally:
            self._change_users(-1)


silent_opencv = _Silence()
"""Context in which OpenCV logs nothing, in all threads at once."""


def decode_with_opencv(data: bytes) -> Decoded:
    """Pixels as the file stores them, without alpha, and its EXIF.

    Raises:
        InputError: it is damaged.
        cv2.error: likewise, or there is too little memory.
    """
    with silent_opencv():
        pixels, _, metadata = cv2.imdecodeWithMetadata(np.frombuffer(data, np.uint8), flags=_FLAGS)
    if pixels is None or not pixels.size:
        raise InputError(
            "is damaged, or of a variant that cannot be decoded", "copy it again or convert it"
        )
    exif = metadata[0].tobytes() if len(metadata) else b""
    return Decoded(_without_alpha(pixels), exif)


def can_round_trip(suffix: str) -> bool:
    """Whether an image can be encoded and decoded in a format; the suffix has its dot."""
    try:
        ok, data = cv2.imencode(suffix, np.full((16, 16, 3), 128, np.uint8))
        return bool(ok) and cv2.imdecode(data, cv2.IMREAD_UNCHANGED) is not None
    except cv2.error:
        return False


def _without_alpha(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    channels = pixels.shape[2] if pixels.ndim == _RANK_OF_COLOUR else 1
    if channels in (1, _GRAY_ALPHA):
        return pixels.reshape(*pixels.shape[:2], channels)[..., 0]
    if pixels.dtype in (np.uint8, np.uint16, np.float32):
        return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)  # type: ignore[arg-type] # four as well
    return pixels[..., 2::-1]
