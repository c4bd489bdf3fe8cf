"""Depth videos: reading them losslessly, and the labels that describe their frames."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from depthcli.core.types import PIXEL_ASPECTS, DepthKind, DepthMap, Frame, Window, Windows
from depthcli.errors import InputError
from depthcli.io.media import LABEL_PREFIX
from depthcli.io.stored import metadata
from depthcli.io.stored.depth import StoredDepth
from depthcli.video import formats, frames
from depthcli.video.container import open_video

_ROUNDED_S = 0.001  # times in Matroska
_ORIGIN = re.compile(r"(-?\d{1,8}),(-?\d{1,8})", re.ASCII)

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
        warnings: one line each.
    """

    def __init__(self, path: str | Path, *, scale: float | None = None) -> None:
        """Open a depth video: 16-bit gray, FFV1 in Matroska.

        ``scale`` is units per metre; None for what the file states, or millimetres. InputError if
        it is missing, damaged, or not 16-bit gray.
        """
        self.path = Path(path)
        container, stream = open_video(self.path)
        pixel_format, fps = stream.codec_context.pix_fmt, stream.average_rate
        if pixel_format != formats.DEPTH_PIXELS:
            raise InputError(f"{self.path} is not 16-bit gray, so it holds no depth")
        labels = {
            name.removeprefix(LABEL_PREFIX).lower(): text
            for name, text in container.metadata.items()
            if name.startswith(LABEL_PREFIX)
        }
        size_px = stream.codec_context.width, stream.codec_context.height
        self.labels, self.warnings = metadata.of_size(labels, size_px, self.path.name)
        label = self.labels.get
        # Matroska stores nanoseconds a frame, which is not exact for some rates.
        self.rate = frames.parse_rate(label("frame_rate", "")) or frames.exact_rate(fps or 0)
        kind = label("kind")
        self.kind = DepthKind(kind) if kind in set(DepthKind) else DepthKind.METRIC
        self._stated = metadata.depth_scale(self.labels, scale)
        self.scale = self._stated and self._stated.units_per_metre
        self._source_rate = frames.parse_rate(label("source_rate", ""))
        step = metadata.number(label("frame_step"))
        self._step = None if self._source_rate and step is None else int(step or 1)
        time_code = None
        if self._source_rate is not None:
            time_code = frames.parse_time_code(label("time_code", ""), self._source_rate)
        elif self.rate is not None:  # of another program
            self._source_rate = self.rate
            time_code = frames.header_time_code(container, stream, self.rate)
        self._first = Frame(
            np.zeros((1, 1), np.uint8),
            index=int(metadata.number(label("first_frame")) or 0),
            rate=self._source_rate,  # which the numbers count
            pixel_aspect=metadata.number(label("pixel_aspect"), *PIXEL_ASPECTS) or 1.0,
            time_code=time_code,
        )
        container.close()

    def __iter__(self) -> Iterator[DepthMap]:
        """Depth maps, (H, W) float32: metres, NaN where there is no depth.

        Their provenance has the time of each frame, exact if frames are evenly spaced.
        In a normalized file, values are 0 to 1 over the range of the preview.
        """
        return (stored.depth for stored in self.frames())

    def frames(self, name: str | None = None) -> Iterator[StoredDepth]:
        """Its maps; the ``Frame`` of each has its number, time, rate and time code.

        Numbers are those of ``depthcli video``, if it wrote the file; else they count from 0.
        ``name`` is that of the file in messages; None for its path.

        Raises:
            InputError: a frame is damaged or missing; those before it have been yielded.
        """
        source, scale = metadata.provenance_of(self.labels), self.scale
        first_s, last = None, self._first.index - 1
        origin = _ORIGIN.fullmatch(self.labels.get("display_origin", ""))
        code, rate = self._first.time_code, self._source_rate
        for count, (number, read_s, steps) in enumerate(self._timed_steps()):
            values = (
                metadata.denormalized(steps, 0, 1)
                if scale is None
                else metadata.dequantized(steps, scale)
            )
            first_s = read_s if first_s is None else first_s
            since_first = round((read_s - first_s) * (rate or 0))
            exact_s = first_s + float(since_first / rate) if rate else read_s
            time_s = exact_s if abs(exact_s - read_s) < _ROUNDED_S else read_s
            depth = DepthMap(values, self.kind, replace(source, time_s=time_s))
            counted = self._first.index + (count * self._step if self._step else since_first)
            # No two frames have one number, even if their times are too coarse for it.
            last = max(counted if number is None else number, last + 1)
            windows = None
            if origin is not None:  # of a display window that does not begin at (0, 0)
                whole = Window(0, 0, depth.width, depth.height)
                windows = Windows(*[whole.moved(int(origin[1]), int(origin[2]))] * 3)
            frame = replace(
                self._first,
                index=last,
                timestamp_s=time_s,
                windows=windows,
                time_code=frames.time_code_after(code, since_first, rate)
                if code and rate
                else None,
            )
            yield StoredDepth(
                name or str(self.path),
                depth,
                self.labels,
                self._stated,
                is_integer=True,
                frame=frame,
                warnings=self.warnings if count == 0 else (),
            )

    def steps(self) -> Iterator[npt.NDArray[np.uint16]]:
        """The stored values, (H, W) uint16: millimetres by default; 0 where there is no depth."""
        return (steps for _, _, steps in self._timed_steps())

    def _timed_steps(self) -> Iterator[tuple[int | None, float, npt.NDArray[np.uint16]]]:
        """Number, if it is stated, and time in seconds of each frame, and its stored values."""
        # Loads FFmpeg, which other names of the Python API do not need.
        from depthcli.video.decoder import FrameDecoder, is_incomplete_matroska  # noqa: PLC0415

        container, stream = open_video(self.path)
        try:
            decoder = FrameDecoder(container, stream, is_own=bool(self.labels))
            count = first_ticks = 0
            start_s = metadata.number(self.labels.get("start_s")) or 0.0
            for frame in decoder.frames:
                self._check(decoder, count, frame.pts)
                steps = frame.to_ndarray()
                first_ticks = first_ticks if count else frame.pts or 0
                time_s = start_s + float(((frame.pts or 0) - first_ticks) * (frame.time_base or 0))
                number = frame.opaque if isinstance(frame.opaque, int) else None
                yield number, time_s, np.ascontiguousarray(steps, np.uint16)
                count += 1
            self._check(decoder, count)
            if decoder.ended_early or is_incomplete_matroska(self.path, container):
                raise InputError(f"{self.path} is truncated or damaged: it ends after {count}")
        except OSError as error:
            raise InputError(f"{self.path} cannot be read: {error.strerror or error}") from error
        finally:
            container.close()

    def _check(self, decoder: FrameDecoder, count: int, before: int | None = None) -> None:
        if decoder.pop_failed(before):
            where = f"after frame {count - 1}" if count else "from its first frame on"
            raise InputError(f"{self.path} is damaged {where}", "write it again")


def frame_texts(first: Frame, timing: frames.Timing) -> dict[str, str]:
    """Labels that tell number, time code and geometry of all frames by those of the first one."""
    texts = {"first_frame": str(first.index)}
    if timing.source_rate is not None:
        texts["source_rate"] = frames.rate_text(timing.source_rate)
        if timing.step is not None:
            texts["frame_step"] = str(timing.step)
        if first.time_code is not None:
            texts["time_code"] = frames.time_code_text(first.time_code, timing.source_rate)
    if first.pixel_aspect != 1:
        texts["pixel_aspect"] = f"{first.pixel_aspect:.9g}"
    if first.windows is not None and first.windows.display[:2] != (0, 0):
        texts["display_origin"] = "{},{}".format(*first.windows.display[:2])
    return texts
