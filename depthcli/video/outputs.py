"""The outputs of a video: lossless depth, a preview, or a file for each frame."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, Self

import av

from depthcli.core.types import DepthMap, Frame, displayed_depth, displayed_frame
from depthcli.io.depth.metadata import metadata_texts, step_unit
from depthcli.io.depth.scale import UINT16_MAX, normalized, quantized
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.table import LABEL_PREFIX, Writer
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.guard import Guard
from depthcli.video.audio import AudioTrack
from depthcli.video.container import OutputPipe
from depthcli.video.depth_video import FrameLabels
from depthcli.video.encoder import VideoFile, av_frame, video_file
from depthcli.video.formats import Codec
from depthcli.video.frames import Timing, rate_text
from depthcli.video.time_code import time_code_label


@dataclass(frozen=True, slots=True)
class DepthFrame:
    """A frame with its depth, ready to be written."""

    image: Frame  #: the frame of the video
    depth: DepthMap  #: its depth
    spread: tuple[float, float]  #: low and high end of the preview's range
    is_kept: bool = False  #: whether an earlier run wrote it

    @property
    def time_s(self) -> float:
        """When the frame is shown."""
        return self.image.timestamp_s or 0.0

    def displayed(self) -> Self:
        """The frame without overscan, which formats without a display window cannot mark."""
        depth = displayed_depth(self.depth, self.image.windows)
        return replace(self, image=displayed_frame(self.image), depth=depth)


class VideoOutput(Protocol):
    """One output of a video."""

    @property
    def has_overscan(self) -> bool:
        """Whether its frames include the pixels outside the display window."""
        ...

    def encode(self, frame: DepthFrame) -> Any:  # noqa: ANN401 - each output has its own
        """Encode a frame; in any thread, in any order."""
        ...

    def append(self, encoded: Any) -> None:  # noqa: ANN401
        """Write an encoded frame; called in the order of the frames."""
        ...

    def finish(self) -> tuple[str, ...]:
        """Complete the output.

        Returns:
            Warnings, one line each.
        """
        ...


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
        self._numbers = FrameLabels()

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
        labels = {}
        if self._first is None:
            self._first = frame
            self._numbers = FrameLabels.of_first(frame.image, self._timing)
            labels = self._labels(frame)
        number = frame.image.index
        # The container rounds times, so numbers do not follow from them.
        follows = self._numbers.step is not None and number == self._numbers.number(self._count, 0)
        stated = None if follows else number
        self._file.write(coded_frame, frame.time_s, labels, stated, frame.image.pixel_aspect)
        self._saturated += saturated
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

    def _labels(self, frame: DepthFrame) -> dict[str, str]:
        labels = metadata_texts(frame.depth) | {
            "frame_rate": rate_text(self._timing.rate),
            **self._numbers.texts(),
            "start_s": f"{frame.time_s:.12g}",
        }
        labels.pop("time_s", None)  # each frame has its own
        if frame.depth.is_metric:
            labels |= {"scale": f"{self._scale:g}", "unit": step_unit(self._scale)}
        else:
            labels |= {"scale": "normalized"}
        own = {f"{LABEL_PREFIX}{name.upper()}": text for name, text in labels.items()}
        return own | time_code_label(frame.image.time_code, self._timing)


@contextmanager
def preview_video(
    target: Path | OutputPipe,
    timing: Timing,
    writer: PreviewWriter,
    guard: Guard | None,
    *,
    codec: Codec = Codec.H264,
    audio: AudioTrack | None = None,
) -> Iterator[VideoOutput]:
    """A preview, written atomically or into a pipe.

    The target ends in ``.mp4``, ``.webm`` or ``.mov``, and that container supports the codec.
    """
    with video_file(target, codec, timing, guard, audio) as file:
        yield PreviewVideoOutput(file, codec, timing, writer)


class PreviewVideoOutput:
    """Previews in the colour range of each frame's ``spread``."""

    has_overscan = False

    def __init__(
        self, file: VideoFile, codec: Codec, timing: Timing, writer: PreviewWriter
    ) -> None:
        self._file = file
        self._timing = timing
        self._codec = codec
        self._writer = writer

    def encode(self, frame: DepthFrame) -> tuple[av.VideoFrame, DepthFrame]:
        """Render the preview of a frame; also returns the frame."""
        pixels = self._writer.render(frame.depth, frame.image, frame.spread)
        return av_frame(pixels, self._codec), frame

    def append(self, encoded: tuple[av.VideoFrame, DepthFrame]) -> None:
        """Write a frame."""
        coded_frame, frame = encoded
        label = time_code_label(frame.image.time_code, self._timing)
        aspect = frame.image.pixel_aspect
        self._file.write(coded_frame, frame.time_s, label, pixel_aspect=aspect)

    def finish(self) -> tuple[str, ...]:
        """Complete the file and its audio."""
        return self._file.finish()


class SequenceOutput:
    """One file a frame, in one of the formats of images, each written atomically."""

    def __init__(
        self,
        label: str,
        folder: Path,
        name: Callable[[int], str],
        writer: Writer,
        guard: Guard | None,
        *,
        has_overscan: bool = False,
    ) -> None:
        """Prepare the output.

        Args:
            label: name of the format in warnings.
            folder: where files are written.
            name: the name of a file by the frame's number.
            writer: of the format.
            guard: of existing files; None to replace any.
            has_overscan: whether frames include the pixels outside the display window.
        """
        self.has_overscan = has_overscan
        self._label = label
        self._folder = folder
        self._name = name
        self._writer = writer
        self._guard = guard
        self._warned = 0
        self._warning = ""

    def encode(self, frame: DepthFrame) -> tuple[str, ...]:
        """Write the file; in any order."""
        if frame.is_kept:
            return ()
        path = self._folder / self._name(frame.image.index)
        with atomic_path(path, guard=self._guard) as temporary:
            return self._writer.write(frame.depth, temporary, frame.image)

    def append(self, encoded: tuple[str, ...]) -> None:
        """Remember the first warning, and count them."""
        if encoded:
            self._warning = self._warning or encoded[0]
            self._warned += 1

    def finish(self) -> tuple[str, ...]:
        """Return the first warning, with their number."""
        if not self._warned:
            return ()
        return (f"{self._label}: {self._warned} frames, the first: {self._warning}",)
