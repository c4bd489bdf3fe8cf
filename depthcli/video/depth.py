"""Reading depth videos, losslessly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from depthcli.core.types import DepthMap, Provenance
from depthcli.errors import InputError
from depthcli.io.depth.metadata import kind_named, number, provenance_of
from depthcli.io.depth.quantization import denormalized, dequantized
from depthcli.io.depth.stored import step_scale
from depthcli.io.formats.table import LABEL_PREFIX
from depthcli.video.codecs import DEPTH_PIXELS
from depthcli.video.rates import exact_rate, parse_rate

if TYPE_CHECKING:
    from collections.abc import Iterator

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
        # Other names of the Python API do not need FFmpeg.
        from depthcli.video.container import open_video  # noqa: PLC0415

        container, stream = open_video(self.path)
        pixel_format, fps = stream.codec_context.pix_fmt, stream.average_rate
        texts = dict(container.metadata)
        container.close()
        if pixel_format != DEPTH_PIXELS:
            raise InputError(f"{self.path} is not 16-bit gray, so it holds no depth")
        self.labels = {
            name.removeprefix(LABEL_PREFIX).lower(): text
            for name, text in texts.items()
            if name.startswith(LABEL_PREFIX)
        }
        # Matroska stores nanoseconds a frame, which is not exact for some rates.
        self.rate = parse_rate(self.labels.get("frame_rate")) or exact_rate(fps or 0)
        self.kind = kind_named(self.labels.get("kind"))
        stated = step_scale(self.labels, scale)
        self.scale = stated and stated.units_per_metre

    def __iter__(self) -> Iterator[DepthMap]:
        """Depth maps, (H, W) float32: metres, NaN where there is no depth.

        Their provenance has the time of each frame, as precise as the container stores it.
        In a normalized file, values are 0 to 1 over the range of the preview.
        """
        return (depth for _, depth in self.numbered_maps())

    def numbered_maps(self) -> Iterator[tuple[int | None, DepthMap]]:
        """Depth maps as iterating gives them, each after its frame's number.

        The number is None if the file does not state it beside the frame: it follows from the
        labels then.
        """
        source = provenance_of(self.labels) or Provenance()
        for frame_number, time_s, steps in self._timed_steps():
            scale = self.scale
            values = denormalized(steps, 0, 1) if scale is None else dequantized(steps, scale)
            yield frame_number, DepthMap(values, self.kind, replace(source, time_s=time_s))

    def steps(self) -> Iterator[npt.NDArray[np.uint16]]:
        """The stored values, (H, W) uint16: millimetres by default; 0 where there is no depth.

        Raises:
            InputError: a frame is damaged or missing; those before it have been yielded.
        """
        return (steps for _, _, steps in self._timed_steps())

    def _timed_steps(self) -> Iterator[tuple[int | None, float, npt.NDArray[np.uint16]]]:
        """Number, if it is stated, and time in seconds of each frame, and its stored values."""
        from depthcli.video.container import open_video  # noqa: PLC0415
        from depthcli.video.decoder import FrameDecoder  # noqa: PLC0415
        from depthcli.video.integrity import is_incomplete_matroska  # noqa: PLC0415

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
                frame_number = decoder.stated_number(frame)
                yield frame_number, time_s, np.ascontiguousarray(steps, np.uint16)
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
            raise InputError(f"{self.path} is damaged {where}; write it again")
