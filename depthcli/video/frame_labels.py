"""Metadata of a depth video about its frames: their numbers, time code and geometry."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Self

from depthcli.core.types import Frame
from depthcli.core.windows import Window, Windows
from depthcli.io.depth.metadata import number, pixel_aspect_in
from depthcli.video.rates import Timing, parse_rate, rate_text
from depthcli.video.time_code import (
    TimeCode,
    parse_time_code,
    time_code_after,
    time_code_text,
)


@dataclass(frozen=True, slots=True)
class FrameLabels:
    """What is known of all frames of a depth video.

    Attributes:
        first: number of the first frame.
        step: difference of consecutive numbers; None if numbers follow the times at the source's
            rate.
        source_rate: frames a second of the source; None if it is not known.
        time_code: of the first frame, as a ``Frame`` has it; None if it has none.
        pixel_aspect: width by height of a pixel.
        origin_px: (x, y), first pixel of the display window.
    """

    first: int = 0
    step: int | None = 1
    source_rate: Fraction | None = None
    time_code: TimeCode | None = None
    pixel_aspect: float = 1.0
    origin_px: tuple[int, int] = (0, 0)

    @classmethod
    def of_first(cls, frame: Frame, timing: Timing) -> Self:
        """Those of a video that begins with a frame."""
        display = frame.windows.display if frame.windows else None
        return cls(
            first=frame.index,
            step=timing.step,
            source_rate=timing.source_rate,
            time_code=frame.time_code,
            pixel_aspect=frame.pixel_aspect,
            origin_px=(display.left, display.top) if display else (0, 0),
        )

    @classmethod
    def parse(cls, texts: Mapping[str, str]) -> Self:
        """Those that a file states; the default for what it does not state."""
        rate = parse_rate(texts.get("source_rate"))
        step = number(texts.get("frame_step"))
        origin = re.fullmatch(r"(-?\d{1,8}),(-?\d{1,8})", texts.get("display_origin", ""), re.ASCII)
        return cls(
            first=int(number(texts.get("first_frame")) or 0),
            step=None if rate and step is None else int(step or 1),
            source_rate=rate,
            time_code=parse_time_code(texts.get("time_code", ""), rate) if rate else None,
            pixel_aspect=pixel_aspect_in(texts.get("pixel_aspect")),
            origin_px=(int(origin[1]), int(origin[2])) if origin else (0, 0),
        )

    def texts(self) -> dict[str, str]:
        """The metadata to write; without what is the default."""
        texts = {"first_frame": str(self.first)}
        if self.source_rate is not None:
            texts["source_rate"] = rate_text(self.source_rate)
            if self.step is not None:
                texts["frame_step"] = str(self.step)
            if self.time_code is not None:
                texts["time_code"] = time_code_text(self.time_code, self.source_rate)
        if self.pixel_aspect != 1:
            texts["pixel_aspect"] = f"{self.pixel_aspect:.9g}"
        if self.origin_px != (0, 0):
            texts["display_origin"] = "{},{}".format(*self.origin_px)
        return texts

    def number(self, count: int, after_s: float) -> int:
        """The number of a frame.

        Args:
            count: how many frames of the video precede it.
            after_s: its time after the first one.
        """
        if self.step is not None:
            return self.first + count * self.step
        return self.first + self._source_frames(after_s)

    def time_code_at(self, after_s: float) -> TimeCode | None:
        """The time code of a frame by its time after the first one."""
        if self.time_code is None or self.source_rate is None:
            return None
        return time_code_after(self.time_code, self._source_frames(after_s), self.source_rate)

    def windows(self, width: int, height: int) -> Windows | None:
        """The windows of frames of a size; None if their display window begins at (0, 0)."""
        if self.origin_px == (0, 0):
            return None
        display = Window(0, 0, width, height).moved(*self.origin_px)
        return Windows(display, display, display)

    def _source_frames(self, after_s: float) -> int:
        return round(after_s * (self.source_rate or 0))
