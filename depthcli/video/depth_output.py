"""A video's depth as one lossless file."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt

from depthcli.io.depth.steps import TOP, quantized
from depthcli.io.writers.facts import facts, step_unit
from depthcli.video.codecs import Codec
from depthcli.video.coding import coded
from depthcli.video.depth import LABEL_PREFIX
from depthcli.video.file import VideoFile, video_file
from depthcli.video.output import VideoFrame, VideoOutput
from depthcli.video.pipes import OutputPipe
from depthcli.video.rates import Timing, rate_text


@contextmanager
def depth_video(
    target: Path | OutputPipe,
    timing: Timing,
    scale: float,
    inputs: Sequence[Path],
    written: Path | None = None,
) -> Iterator[VideoOutput]:
    """A lossless depth video that appears whole or not at all, or goes into a pipe.

    Args:
        target: ends in ``.mkv``.
        timing: of the frames.
        scale: steps per metre.
        inputs: files that must not be replaced.
        written: where it is until it is whole, and stays if the block fails; None for a
            temporary name.
    """
    with video_file(target, Codec.FFV1, timing, inputs, written=written) as file:
        yield DepthVideoOutput(file, timing, scale)


class DepthVideoOutput:
    """Lossless 16-bit gray: steps of depth, 0 = no depth, saturating."""

    def __init__(self, file: VideoFile, timing: Timing, scale: float) -> None:
        self._file = file
        self._timing = timing
        self._scale = scale
        self._saturated = 0
        self._first: VideoFrame | None = None

    def encode(self, frame: VideoFrame) -> tuple[VideoFrame, av.VideoFrame, int]:
        """Depth in whole steps, and how many pixels were saturated."""
        if frame.depth.is_metric:
            steps, saturated = quantized(frame.depth.values, self._scale)
        else:
            steps, saturated = within(frame.depth.values, *frame.spread), 0
        return frame, coded(steps, Codec.FFV1), saturated

    def append(self, encoded: tuple[VideoFrame, av.VideoFrame, int]) -> None:
        """Write the steps; with the first ones, labels with rate, scale, unit and model."""
        frame, coded_frame, saturated = encoded
        labels = {} if self._first else self._labels(frame)
        self._first = self._first or frame
        self._saturated += saturated
        self._file.write(coded_frame, frame.time_s, labels)

    def finish(self) -> tuple[str, ...]:
        """Complete the file."""
        self._file.finish()
        if self._first is not None and not self._first.depth.is_metric:
            kind = self._first.depth.kind
            return (f"{kind} depth has no unit; mkv is normalized to the preview's range",)
        if not self._saturated:
            return ()
        limit_m = TOP / self._scale
        return (f"mkv: {self._saturated} pixels beyond {limit_m:.6g} m were saturated",)

    def _labels(self, frame: VideoFrame) -> dict[str, str]:
        labels = facts(frame.depth) | {
            "frame_rate": rate_text(self._timing.rate),
            "first_frame": str(frame.picture.index),
        }
        if frame.depth.is_metric:
            labels |= {"scale": f"{self._scale:g}", "unit": step_unit(self._scale)}
        else:
            labels |= {"scale": "normalized"}
        return {f"{LABEL_PREFIX}{name.upper()}": text for name, text in labels.items()}


def within(values: npt.NDArray[np.float32], low: float, high: float) -> npt.NDArray[np.uint16]:
    """Values of a range as 1-65535, those beyond at its ends; 0 where there is none.

    (H, W) float32 in, (H, W) uint16 out.
    """
    share = (np.nan_to_num(values, nan=low) - low) / ((high - low) or 1.0)
    steps = np.rint(1 + np.clip(share, 0, 1) * (TOP - 1))
    return np.where(np.isnan(values), 0, steps).astype(np.uint16)
