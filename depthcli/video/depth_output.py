"""Writing a video's depth to one lossless file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av

from depthcli.io.depth.quantization import UINT16_MAX, normalized, quantized
from depthcli.io.formats.metadata import metadata_texts, step_unit
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.table import LABEL_PREFIX
from depthcli.io.storage.guard import Guard
from depthcli.video.av_frame import av_frame
from depthcli.video.codecs import Codec
from depthcli.video.file import VideoFile, video_file
from depthcli.video.frame_labels import FrameLabels
from depthcli.video.output import DepthFrame, VideoOutput
from depthcli.video.pipes import OutputPipe
from depthcli.video.rates import Timing, rate_text
from depthcli.video.time_code import time_code_label

_COLOURS = PreviewWriter()


@contextmanager
def depth_video(
    target: Path | OutputPipe,
    timing: Timing,
    scale: float,
    guard: Guard | None,
    colours: PreviewWriter = _COLOURS,
) -> Iterator[VideoOutput]:
    """A lossless depth video, written atomically or into a pipe.

    Args:
        target: ends in ``.mkv``.
        timing: of the frames.
        scale: units per metre.
        guard: of existing files; None to replace any.
        colours: whose ends are those of a normalized file.
    """
    with video_file(target, Codec.FFV1, timing, guard) as file:
        yield DepthVideoOutput(file, timing, scale, colours)


class DepthVideoOutput:
    """Quantized depth as lossless 16-bit gray: 0 = no depth, saturating."""

    has_overscan = False

    def __init__(
        self, file: VideoFile, timing: Timing, scale: float, colours: PreviewWriter
    ) -> None:
        self._file = file
        self._timing = timing
        self._scale = scale
        self._colours = colours
        self._saturated = self._count = 0
        self._first: DepthFrame | None = None

    def encode(self, frame: DepthFrame) -> tuple[DepthFrame, av.VideoFrame, int]:
        """Quantize depth; also returns how many pixels were saturated."""
        depth = frame.depth
        if depth.is_metric:
            steps, saturated = quantized(depth.values, self._scale)
        else:
            low, high = self._colours.range_of(frame.spread)
            steps, saturated = normalized(depth.values, depth.valid, low, high), 0
        return frame, av_frame(steps, Codec.FFV1), saturated

    def append(self, encoded: tuple[DepthFrame, av.VideoFrame, int]) -> None:
        """Write a frame; with the first one, metadata: rate, scale, unit and model."""
        frame, coded_frame, saturated = encoded
        labels = {} if self._first else self._labels(frame)
        self._first = self._first or frame
        self._saturated += saturated
        self._file.write(
            coded_frame,
            frame.time_s,
            labels,
            self._stated_number(frame),
            frame.picture.pixel_aspect,
        )
        self._count += 1

    def finish(self) -> tuple[str, ...]:
        """Complete the file."""
        self._file.finish()
        if self._first is not None and not self._first.depth.is_metric:
            kind = self._first.depth.kind
            return (f"{kind} depth has no unit; mkv is normalized to the preview's range",)
        if not self._saturated:
            return ()
        limit_m = UINT16_MAX / self._scale
        return (f"mkv: {self._saturated} pixels beyond {limit_m:.6g} m were saturated",)

    def _stated_number(self, frame: DepthFrame) -> int | None:
        """The number of a frame if it does not follow from the labels; else None.

        The container rounds times, so numbers do not follow from them.
        """
        first, number = self._first or frame, frame.picture.index
        labels = FrameLabels.of_first(first.picture, self._timing)
        follows = labels.step is not None and number == labels.number(self._count, 0)
        return None if follows else number

    def _labels(self, frame: DepthFrame) -> dict[str, str]:
        labels = metadata_texts(frame.depth) | {
            "frame_rate": rate_text(self._timing.rate),
            **FrameLabels.of_first(frame.picture, self._timing).texts(),
            "start_s": f"{frame.time_s:.12g}",
        }
        labels.pop("time_s", None)  # each frame has its own
        if frame.depth.is_metric:
            labels |= {"scale": f"{self._scale:g}", "unit": step_unit(self._scale)}
        else:
            labels |= {"scale": "normalized"}
        own = {f"{LABEL_PREFIX}{name.upper()}": text for name, text in labels.items()}
        return own | time_code_label(frame.picture.time_code, self._timing)
