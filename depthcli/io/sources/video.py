"""The frames of a video, one after the other, upright and with their times."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Self

import cv2
import numpy as np

from depthcli.core.types import Frame
from depthcli.errors import InputError
from depthcli.io.decode import MAX_PIXELS, check_size
from depthcli.io.frame_rate import exact_rate
from depthcli.io.sources.video_span import WHOLE
from depthcli.io.video_capture import open_capture
from depthcli.io.video_end import counts_frames, is_cut

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType

    from depthcli.core.picture_limit import PictureLimit
    from depthcli.io.sources.video_span import Span

FALLBACK_RATE = Fraction(25)
_MOST_FRAMES = 1 << 40
_MISSING_SHARE = 200
_LONGEST_DAMAGE = 250
# Matroska keeps milliseconds, so a frame this near to its place on the grid stands there.
_ROUNDING_S = 0.0011
_EXIF_OF_TURN = {90: 6, 180: 3, 270: 8}


class VideoSource:
    """A video file, read from its beginning to its end with one frame in memory.

    Attributes:
        path: the file.
        rate: frames a second, exact; the mean where frames are not evenly spaced.
        frames_stated: frames that the file says it has; None if it does not say.
        width: columns of an upright frame.
        height: rows of an upright frame.
        warnings: one-line texts about the file.
        problem: why frames are missing, once the others have been read; None if all came.
    """

    def __init__(self, path: str | Path, *, max_pixels: int | PictureLimit = MAX_PIXELS) -> None:
        """Open a video.

        Args:
            path: whatever OpenCV's FFmpeg reads.
            max_pixels: frames that claim more are refused.

        Raises:
            InputError: missing, empty, no video, no video stream in it, or too large.
        """
        self.path = Path(path)
        self._capture = open_capture(self.path)
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        self.width = round(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = round(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        try:
            check_size(str(self.path), self.width, self.height, max_pixels)
        except InputError:
            self.close()
            raise
        rate = exact_rate(self._capture.get(cv2.CAP_PROP_FPS))
        self.rate = rate or FALLBACK_RATE
        self.warnings = (
            () if rate else (f"the file states no frame rate; {FALLBACK_RATE} a second is taken",)
        )
        self.frames_stated = _count(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.problem: str | None = None
        self._lost = 0
        self._index = 0
        self._time_s = Fraction(-1)

    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """Decode the frames of a span; to be called once.

        Frames before and between are decoded too, for exactness, but not converted.

        Yields:
            RGB uint8, (H, W, 3); ``index`` counts all frames of the file from 0, also damaged ones,
            which are passed over; ``timestamp_s`` counts from the first and always grows. A turn
            that the file asks for is done.
        """
        turn = round(self._capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360
        for wanted in span.picks(self._places()):
            if not wanted:
                continue
            pixels = self._pixels()
            if pixels is None:
                return
            yield Frame(
                pixels,
                self.path,
                self._index,
                float(self._time_s),
                orientation=_EXIF_OF_TURN.get(turn, 1),
            )

    def close(self) -> None:
        """Let the file go."""
        self._capture.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _places(self) -> Iterator[tuple[int, Fraction]]:
        """Number and time of each frame, while it is the one at hand."""
        index = 0
        first_ms = 0.0
        while (failed := self._passed_over(index)) is not None:
            measured_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC)
            if self._time_s < 0:  # frames lost before the first one had their times, too
                first_ms = measured_ms - float(1000 * failed / self.rate)
            measured_s = (measured_ms - first_ms) / 1000
            index += self._missed(index, measured_s, failed) if failed else 0
            time_s = self._time(index, measured_s)
            # The last frames of MPEG streams can be without a time.
            grows = time_s > self._time_s
            self._time_s = time_s if grows else self._time_s + 1 / self.rate
            self._index = index
            yield index, self._time_s
            index += 1
        self._judge_end(index)

    def _missed(self, index: int, measured_s: float, failed: int) -> int:
        """How many frames are missing before the one at hand, by its time if that is regular."""
        by_time = round(measured_s * self.rate)
        if self._is_regular(by_time, measured_s):
            failed = by_time - index
        if failed > 0:
            self._lost += failed
            self.problem = f"it is damaged: {self._lost} frames cannot be decoded"
        return failed

    def _time(self, index: int, measured_s: float) -> Fraction:
        """The frame's place on the grid of the exact rate, or what was measured if it is not."""
        if self._is_regular(index, measured_s):
            return index / self.rate
        return Fraction(measured_s).limit_denominator(1_000_000)

    def _is_regular(self, index: int, measured_s: float) -> bool:
        return abs(float(index / self.rate) - measured_s) <= _ROUNDING_S

    def _passed_over(self, index: int) -> int | None:
        """Go to the next frame that can be decoded, while the file says that there are more.

        Returns:
            How often that failed before; None at the end.
        """
        left = (self.frames_stated or 0) - index
        tries = range(max(1, min(_LONGEST_DAMAGE, left)))
        return next((failed for failed in tries if self._grab()), None)

    def _grab(self) -> bool:
        try:
            return self._capture.grab()
        except cv2.error:
            return False

    def _pixels(self) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]] | None:
        try:
            ok, pixels = self._capture.retrieve()
        except cv2.error:
            ok, pixels = False, None
        if not ok or pixels is None:
            self.problem = "a frame cannot be decoded; the frames before it are done"
            return None
        if pixels.shape[:2] != (self.height, self.width):
            self.problem = "the frames change their size; those before are done"
            return None
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), np.uint8)

    def _judge_end(self, read: int) -> None:
        """Compare what came with what the file said."""
        stated = self.frames_stated if counts_frames(self.path) else None
        short = stated is not None and stated - read > max(1, stated // _MISSING_SHARE)
        if short or is_cut(self.path):
            of = "" if stated is None else f" of {stated}"
            self.problem = f"it is truncated or damaged: it ends after {read}{of} frames"


def _count(frames: float) -> int | None:
    return int(frames) if 0 < frames < _MOST_FRAMES else None
