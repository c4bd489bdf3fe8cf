"""Reading depth videos back, frame for frame as they were written."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError
from depthcli.io.depth_facts import positive, provenance_of
from depthcli.io.frame_rate import exact_rate
from depthcli.io.mkv_finish import mkv_labels
from depthcli.io.video_capture import open_capture

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

_MILLIMETRES = 1000.0
_TOP = 65535


class DepthVideo:
    """A 16-bit gray video of depth, such as ``depthcli video`` writes.

    Iterating reads it from the beginning, with one frame in memory.

    Attributes:
        path: the file.
        rate: frames a second, exact; None if the file does not say.
        labels: what the file says of itself: scale, kind, unit, model and so on; empty for a file
            of another program.
        scale: steps per metre; None if the file is normalized and has no unit.
        kind: what the numbers mean.
    """

    def __init__(self, path: str | Path, *, scale: float | None = None) -> None:
        """Open a depth video.

        Args:
            path: a 16-bit gray video, FFV1 in Matroska.
            scale: steps per metre; None for what the file says of itself, or millimetres.

        Raises:
            InputError: missing, damaged, or not 16-bit gray.
        """
        self.path = Path(path)
        capture = self._opened()
        fps = capture.get(cv2.CAP_PROP_FPS)
        capture.release()
        self.labels = mkv_labels(self.path)
        # A container keeps nanoseconds a frame, which is less than some rates need.
        self.rate = _fraction(self.labels.get("frame_rate")) or exact_rate(fps)
        kind = self.labels.get("kind")
        self.kind = DepthKind(kind) if kind in set(DepthKind) else DepthKind.METRIC
        stated = self.labels.get("scale")
        self.scale = scale or (None if stated == "normalized" else positive(stated) or _MILLIMETRES)
        next(self.steps(), None)

    def __iter__(self) -> Iterator[DepthMap]:
        """Depth maps, (H, W) float32: metres, NaN where there is no depth.

        Of a normalized file the values are shares, 0 to 1, of the range that was shown.
        """
        for steps in self.steps():
            if self.scale is None:
                values = (steps.astype(np.float32) - 1) / np.float32(_TOP - 1)
            else:
                values = steps.astype(np.float32) / np.float32(self.scale)
            known = np.where(steps == 0, np.float32(np.nan), values)
            yield DepthMap(known, self.kind, provenance_of(self.labels))

    def steps(self) -> Iterator[npt.NDArray[np.uint16]]:
        """The stored numbers, (H, W) uint16: millimetres by default; 0 where there is no depth.

        Raises:
            InputError: a frame is not 16-bit gray.
        """
        capture = self._opened()
        width, height = (
            int(positive(self.labels.get(name)) or _TOP + 1) for name in ("width", "height")
        )
        try:
            while True:
                ok, pixels = capture.read()
                if not ok:
                    return
                if pixels.dtype != np.uint16 or pixels.squeeze().ndim > 2:  # noqa: PLR2004
                    raise InputError(f"{self.path} is not 16-bit gray, so it holds no depth")
                gray = pixels.reshape(pixels.shape[:2])
                yield np.ascontiguousarray(gray[:height, :width])
        finally:
            capture.release()

    def _opened(self) -> cv2.VideoCapture:
        capture = open_capture(self.path)
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        return capture


def _fraction(text: str | None) -> Fraction | None:
    found = re.fullmatch(r"([1-9]\d{0,14})/([1-9]\d{0,14})", text or "", re.ASCII)
    return Fraction(int(found[1]), int(found[2])) if found else None
