"""Depth videos: reading them losslessly, and the labels that describe their frames."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from depthcli.core.types import DepthMap, Frame, Provenance, Window, Windows
from depthcli.errors import InputError
from depthcli.io.depth.metadata import (
    kind_named,
    number,
    of_size,
    pixel_aspect_in,
    provenance_of,
)
from depthcli.io.depth.read import StoredDepth
from depthcli.io.depth.scale import denormalized, depth_scale, dequantized
from depthcli.io.formats.table import LABEL_PREFIX
from depthcli.video.container import open_video
from depthcli.video.formats import DEPTH_PIXELS
from depthcli.video.frames import (
    TimeCode,
    Timing,
    exact_rate,
    header_time_code,
    parse_rate,
    parse_time_code,
    rate_text,
    time_code_after,
    time_code_text,
)

if TYPE_CHECKING:
    import numpy.typing as npt

    from depthcli.video.decoder import FrameDecoder


class DepthVideo:
    """A 16-bit gray video of depth, such as ``depthcli video`` writes.

    Iterating reads it from the beginning, with one frame in memory.

    Attributes:
        path: the file.
        rate: frames a second, exact; None if the file does not say.
        labels: metadata of the file: scale, kind, unit, model and so on; empty for files of other
            programs.
        scale: units per metre; None if the file is normalized and has no unit.
        kind: what the numbers mean.
        frame_labels: numbers, time code and geometry of its frames.
        warnings: one line each.
    """

    def __init__(self, path: str | Path, *, scale: float | None = None) -> None:
        """Open a depth video.

        Args:
            path: a 16-bit gray video, FFV1 in Matroska.
            scale: units per metre; None for what the file states, or millimetres.

        Raises:
            InputError: missing, damaged, or not 16-bit gray.
        """
        self.path = Path(path)
        container, stream = open_video(self.path)
        pixel_format, fps = stream.codec_context.pix_fmt, stream.average_rate
        texts = dict(container.metadata)
        if pixel_format != DEPTH_PIXELS:
            raise InputError(f"{self.path} is not 16-bit gray, so it holds no depth")
        labels = {
            name.removeprefix(LABEL_PREFIX).lower(): text
            for name, text in texts.items()
            if name.startswith(LABEL_PREFIX)
        }
        size_px = stream.codec_context.width, stream.codec_context.height
        self.labels, self.warnings = of_size(labels, size_px, self.path.name)
        # Matroska stores nanoseconds a frame, which is not exact for some rates.
        self.rate = parse_rate(self.labels.get("frame_rate", "")) or exact_rate(fps or 0)
        self.kind = kind_named(self.labels.get("kind"))
        self._stated = depth_scale(self.labels, scale)
        self.scale = self._stated and self._stated.units_per_metre
        frames = FrameLabels.parse(self.labels)
        if frames.source_rate is None and self.rate is not None:  # of another program
            time_code = header_time_code(container, stream, self.rate)
            frames = replace(frames, source_rate=self.rate, time_code=time_code)
        self.frame_labels = frames
        container.close()

    def __iter__(self) -> Iterator[DepthMap]:
        """Depth maps, (H, W) float32: metres, NaN where there is no depth.

        Their provenance has the time of each frame, as precise as the container stores it.
        In a normalized file, values are 0 to 1 over the range of the preview.
        """
        return (stored.depth for stored in self.frames())

    def frames(self, name: str | None = None) -> Iterator[StoredDepth]:
        """Its maps; the ``Frame`` of each has its number, time, rate and time code.

        Numbers are those of ``depthcli video``, if it wrote the file; else they count from 0.

        Args:
            name: of the file, in messages; None for its path.

        Raises:
            InputError: a frame is damaged or missing; those before it have been yielded.
        """
        source, labels = provenance_of(self.labels) or Provenance(), self.frame_labels
        first_s, number, scale = None, labels.first - 1, self.scale
        for count, (stated_number, time_s, steps) in enumerate(self._timed_steps()):
            values = denormalized(steps, 0, 1) if scale is None else dequantized(steps, scale)
            depth = DepthMap(values, self.kind, replace(source, time_s=time_s))
            first_s = time_s if first_s is None else first_s
            found = (
                labels.number(count, time_s - first_s) if stated_number is None else stated_number
            )
            # No two frames have one number, even if their times are too coarse for it.
            number = max(found, number + 1)
            frame = Frame(
                np.zeros((1, 1), np.uint8),
                index=number,
                timestamp_s=time_s,
                rate=self.rate,
                pixel_aspect=labels.pixel_aspect,
                windows=labels.windows(depth.width, depth.height),
                time_code=labels.time_code_at(time_s - first_s),
            )
            warnings = self.warnings if count == 0 else ()
            yield StoredDepth(
                name or str(self.path),
                depth,
                self.labels,
                self._stated,
                is_integer=True,
                frame=frame,
                warnings=warnings,
            )

    def steps(self) -> Iterator[npt.NDArray[np.uint16]]:
        """The stored values, (H, W) uint16: millimetres by default; 0 where there is no depth.

        Raises:
            InputError: a frame is damaged or missing; those before it have been yielded.
        """
        return (steps for _, _, steps in self._timed_steps())

    def _timed_steps(self) -> Iterator[tuple[int | None, float, npt.NDArray[np.uint16]]]:
        """Number, if it is stated, and time in seconds of each frame, and its stored values."""
        # Loads FFmpeg, which other names of the Python API do not need.
        from depthcli.video.decoder import (  # noqa: PLC0415
            FrameDecoder,
            frame_number,
            is_incomplete_matroska,
        )

        container, stream = open_video(self.path)
        try:
            decoder = FrameDecoder(container, stream, is_own=bool(self.labels))
            count = first_ticks = 0
            start_s = number(self.labels.get("start_s")) or 0.0
            while (frame := decoder.next()) is not None:
                self._check(decoder, count, frame.pts)
                steps = frame.to_ndarray()
                first_ticks = first_ticks if count else frame.pts or 0
                time_s = start_s + float(((frame.pts or 0) - first_ticks) * (frame.time_base or 0))
                yield frame_number(frame), time_s, np.ascontiguousarray(steps, np.uint16)
                count += 1
            self._check(decoder, count)
            if decoder.ended_early or is_incomplete_matroska(self.path):
                raise InputError(f"{self.path} is truncated or damaged: it ends after {count}")
        except OSError as error:
            raise InputError(f"{self.path} cannot be read: {error.strerror or error}") from error
        finally:
            container.close()

    def _check(self, decoder: FrameDecoder, count: int, before: int | None = None) -> None:
        if decoder.pop_failed(before):
            where = f"after frame {count - 1}" if count else "from its first frame on"
            raise InputError(f"{self.path} is damaged {where}", "write it again")


@dataclass(frozen=True, slots=True)
class FrameLabels:
    """Facts about all frames of a depth video.

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
        """Make those of a video that begins with a frame."""
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
        """Read those that a file states; the default for what it does not state."""
        rate = parse_rate(texts.get("source_rate", ""))
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
