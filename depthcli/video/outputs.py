"""The outputs of a video: lossless depth, a preview, a file for each frame; in segments."""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Self, cast

import av
import numpy as np
from av.container import OutputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace, Interpolation
from av.video.stream import VideoStream

from depthcli._version import __version__
from depthcli.core import types
from depthcli.errors import OutputError, about
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.formats.table import Format, WriterOptions, writer_of
from depthcli.io.formats.views import StereoWriter
from depthcli.io.guard import Guard
from depthcli.io.media import COMMENT_PREFIX, LABEL_PREFIX
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.stored.metadata import UINT16_MAX, metadata_texts, normalized, quantized, step_unit
from depthcli.video import decoder, depth_video, formats, frames, numbering
from depthcli.video.audio import AudioTrack
from depthcli.video.container import OutputPipe

_REFUSALS = (av.ArgumentError, av.ExternalError, av.UndefinedError, NotImplementedError)  # of sizes
_BT709 = 1
_KEYFRAME_INTERVAL_S = 2
_PACKINGS = {
    "side-by-side": 3,
    "top-bottom": 4,
}  # by which players know stereo (ITU-T H.264, D.2.26)
_MAX_GOP = 250
_MAX_ASPECT = 1000
_FRAGMENTS = "+frag_keyframe+empty_moov+default_base_moof"


@dataclass(frozen=True, slots=True)
class DepthFrame:
    """A frame with its depth, ready to be written."""

    image: types.Frame  #: the frame of the video
    depth: types.DepthMap  #: its depth
    spread: tuple[float, float]  #: low and high end of the preview's range
    is_kept: bool = False  #: whether an earlier run wrote it

    @property
    def time_s(self) -> float:
        """When the frame is shown."""
        return self.image.timestamp_s or 0.0

    def displayed(self) -> Self:
        """The frame without overscan, which formats without a display window cannot mark."""
        depth = types.displayed_depth(self.depth, self.image.windows)
        return replace(self, image=types.displayed_frame(self.image), depth=depth)


class VideoOutput(ExitStack, ABC):
    """One output of a video; on exit, an incomplete file is removed."""

    has_overscan = False  #: whether its frames include the pixels outside the display window

    @abstractmethod
    def encode(self, frame: DepthFrame) -> Any:  # noqa: ANN401 - each output has its own
        """Encode a frame; in any thread, in any order."""

    @abstractmethod
    def append(self, encoded: Any) -> None:  # noqa: ANN401
        """Write an encoded frame; called in the order of the frames."""

    def finish(self) -> tuple[str, ...]:
        """Complete the output, and return warnings of one line."""
        return ()


class VideoFile(VideoOutput):
    """A video file that is written atomically, or a pipe; frames of one size with their times."""

    _codec: str
    _tags: Mapping[str, str] = {}  #: further options of the encoder
    _container: OutputContainer | None = None
    _stream: VideoStream | None = None
    _ticks = -1
    _first_s = 0.0

    def __init__(
        self,
        target: Path | OutputPipe,
        timing: frames.Timing,
        audio: AudioTrack | None = None,
    ) -> None:
        """Prepare a file; it is opened with the first frame, and replaces any other.

        The suffix of the target chooses the container, which has to support the codec. OutputError
        if there is no encoder.
        """
        formats.check_encoder(self._codec)
        super().__init__()
        self._target, self._timing, self._audio = target, timing, audio

    def __enter__(self) -> Self:
        if not isinstance(self._target, OutputPipe):
            self._target = self.enter_context(atomic_path(self._target))
        self.callback(self._close)
        return self

    def _close(self) -> None:
        if self._audio is not None:
            self._audio.close()
        if self._container is not None:
            with suppress(av.FFmpegError):
                self._container.close()

    def _write(
        self,
        coded: VideoFrame,
        frame: DepthFrame,
        labels: Mapping[str, str],
        number: int | None = None,
    ) -> None:
        """Append a frame, and its number in Matroska; the first one with the labels of the file."""
        if self._container is None or self._stream is None:
            self._first_s = frame.time_s
            self._container = container = self._new_container(labels)
            self._stream = stream = self._add_video(container, coded, frame.image.pixel_aspect)
            self._start(container, coded)
        else:
            container, stream = self._container, self._stream
        time_base = self._timing.time_base
        ticks = round((frame.time_s - self._first_s) / time_base)
        coded.pts = self._ticks = max(ticks, self._ticks + 1)
        coded.time_base = time_base
        coded.duration = max(1, round(1 / (self._timing.rate * time_base)))
        if self._audio is not None:
            self._audio.mux_until(float(self._ticks * time_base))
        packets = stream.encode(coded)
        if number is not None:
            for packet in packets:  # FFV1 has no delay, so it is the frame's
                decoder.state_number(packet, number)
        container.mux(packets)
        self._check_pipe()

    def finish(self) -> tuple[str, ...]:
        """Complete the file, and return warnings; OSError if it cannot be written."""
        if self._container is None or self._stream is None:
            return ()
        if self._audio is not None:
            end_s = self._ticks * self._timing.time_base + 1 / self._timing.rate
            self._audio.mux_until(float(end_s))
        self._container.mux(self._stream.encode())
        container, self._container = self._container, None
        container.close()
        self._check_pipe()
        return self._audio.warnings if self._audio is not None else ()

    def _new_container(self, labels: Mapping[str, str]) -> OutputContainer:
        """A new file without streams, which is reproducible."""
        target, options = self._target, {"fflags": "+bitexact"}
        name, is_pipe = formats.CONTAINERS[target.suffix.lower()], isinstance(target, OutputPipe)
        if name in {"mp4", "mov"}:
            # In a pipe, fragments: an index at the beginning has to wait for all frames.
            layout = _FRAGMENTS if is_pipe else "+faststart"
            ticks = str(self._timing.time_base.denominator)
            options |= {"movflags": layout, "video_track_timescale": ticks}
        file = target if is_pipe else str(target)
        container = av.open(file, "w", format=name, container_options=options)
        container.metadata.update(labels)
        return container

    def _add_video(
        self, container: OutputContainer, frame: VideoFrame, pixel_aspect: float
    ) -> VideoStream:
        """Add a video stream for frames of the size of one."""
        if self._codec == formats.PreviewCodec.AV1:
            os.environ.setdefault("SVT_LOG", "0")  # else it writes to standard error
        encoding, timing = formats.ENCODINGS[self._codec], self._timing
        options = {**dict(encoding.options), **self._tags, "flags": "+bitexact"}
        added = container.add_stream(encoding.encoder, rate=timing.rate, options=options)
        stream = cast("VideoStream", added)
        stream.width, stream.height = frame.width, frame.height
        stream.pix_fmt = encoding.pixel_format
        context = stream.codec_context
        stream.time_base = context.time_base = timing.time_base
        keyframe_interval = max(1, min(round(_KEYFRAME_INTERVAL_S * timing.rate), _MAX_GOP))
        context.gop_size = 1 if encoding.is_intra_only else keyframe_interval
        if encoding.pixel_format != formats.DEPTH_PIXELS:
            context.colorspace = context.color_primaries = context.color_trc = _BT709
            context.color_range = ColorRange.MPEG
        if pixel_aspect != 1:  # PyAV cannot state it in the header of Matroska and WebM
            aspect = Fraction(pixel_aspect).limit_denominator(_MAX_ASPECT)
            context.sample_aspect_ratio = aspect
        return stream

    def _start(self, container: OutputContainer, frame: VideoFrame) -> None:
        """Add the audio, and write the header."""
        if self._audio is not None:
            self._audio.open(container, self._first_s)
            options = container.container_options
            if self._audio.begins_soon and _FRAGMENTS in options.get("movflags", ""):
                # The header waits for the first fragment, and states where the audio begins.
                options["movflags"] += "+delay_moov"
        try:
            container.start_encoding()
        except _REFUSALS as error:
            size = f"{frame.width}×{frame.height}"
            problem = f"no {self._codec} video of {size} pixels can be written"
            advice = "choose an image sequence with {format} png16 or exr"
            raise OutputError(problem, advice) from error
        if self._codec == formats.PreviewCodec.AV1:
            _leave_real_time()

    def _check_pipe(self) -> None:
        if isinstance(self._target, OutputPipe):
            self._target.check()


def _leave_real_time() -> None:
    """Undo the real-time priority that SVT-AV1 takes as root, which starves other processes."""
    for task in Path("/proc/self/task").glob("*"):
        with suppress(OSError):  # the thread has ended
            if os.sched_getscheduler(int(task.name)) == os.SCHED_FIFO:
                os.sched_setscheduler(int(task.name), os.SCHED_OTHER, os.sched_param(0))


def _av_frame(pixels: types.UInt16Array | types.UInt8Array, codec: str) -> VideoFrame:
    """A PyAV frame in the pixel format of a codec; thread-safe.

    Pixels are (H, W) uint16 for FFV1, else (H, W, 3) RGB uint8. For codecs with chroma subsampling,
    an odd row or column is doubled.
    """
    pixel_format, (height, width) = formats.ENCODINGS[codec].pixel_format, pixels.shape[:2]
    if pixel_format == formats.DEPTH_PIXELS:
        return VideoFrame.from_ndarray(
            np.ascontiguousarray(pixels, np.uint16), formats.DEPTH_PIXELS
        )
    odd = (0, height % 2), (0, width % 2), (0, 0)
    even = np.pad(pixels, odd, mode="edge") if height % 2 or width % 2 else pixels
    return VideoFrame.from_ndarray(np.ascontiguousarray(even, np.uint8), "rgb24").reformat(
        format=pixel_format,
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        dst_color_trc=None,
        interpolation=Interpolation.BICUBIC | Interpolation.ACCURATE_RND,
        threads=1,
    )


class DepthVideoOutput(VideoFile):
    """Quantized depth as lossless 16-bit gray: 0 = no depth, saturating."""

    _codec = formats.FFV1

    def __init__(
        self, target: Path | OutputPipe, timing: frames.Timing, writing: WriterOptions
    ) -> None:
        """Prepare the units per metre of 16-bit files; without metres, the ends of previews."""
        super().__init__(target, timing)
        self._writing, self._scale = writing, writing.units_per_metre
        self._saturated = self._count = 0
        self._first: DepthFrame | None = None

    def encode(self, frame: DepthFrame) -> tuple[DepthFrame, VideoFrame, int]:
        """Quantize depth; also returns how many pixels were saturated."""
        depth = frame.depth
        if depth.is_metric:
            steps, saturated = quantized(depth.values, self._scale)
        else:
            low, high = self._writing.range_of(frame.spread)
            steps, saturated = normalized(depth.values, depth.valid, low, high), 0
        return frame, _av_frame(steps, formats.FFV1), saturated

    def append(self, encoded: tuple[DepthFrame, VideoFrame, int]) -> None:
        """Write a frame; with the first one, metadata: rate, scale, unit and model."""
        frame, coded_frame, saturated = encoded
        labels = self._labels(frame) if self._first is None else {}
        self._first = self._first or frame
        # The container rounds times, so numbers do not follow from them.
        number, step = frame.image.index, self._timing.step
        follows = step is not None and number == self._first.image.index + self._count * step
        self._write(coded_frame, frame, labels, None if follows else number)
        self._saturated += saturated
        self._count += 1

    def finish(self) -> tuple[str, ...]:
        """Complete the file."""
        super().finish()
        if self._first is not None and not self._first.depth.is_metric:
            kind = self._first.depth.kind
            return (f"{kind} depth has no unit; mkv is normalized to the preview's range",)
        if not self._saturated:
            return ()
        limit_m = UINT16_MAX / self._scale
        return (f"mkv: {self._saturated} pixels beyond {limit_m:.6g} m were saturated",)

    def _labels(self, frame: DepthFrame) -> dict[str, str]:
        labels = metadata_texts(frame.depth) | {
            "frame_rate": frames.rate_text(self._timing.rate),
            **depth_video.frame_texts(frame.image, self._timing),
            "start_s": f"{frame.time_s:.12g}",
            "scale": f"{self._scale:g}" if frame.depth.is_metric else "normalized",
        }
        labels.pop("time_s", None)  # each frame has its own
        if frame.depth.is_metric:
            labels["unit"] = step_unit(self._scale)
        tags = {f"{LABEL_PREFIX}{name.upper()}": text for name, text in labels.items()}
        return tags | frames.time_code_label(frame.image.time_code, self._timing)


class PreviewVideoOutput(VideoFile):
    """Previews in the colour range of each frame's ``spread``."""

    def __init__(
        self,
        target: Path | OutputPipe,
        timing: frames.Timing,
        writer: PreviewWriter | StereoWriter,
        *,
        codec: formats.PreviewCodec = formats.PreviewCodec.H264,
        audio: AudioTrack | None = None,
    ) -> None:
        """Prepare a file in ``.mp4``, ``.webm`` or ``.mov``, which supports the codec."""
        self._codec, self._writer = codec, writer
        layout = writer.stereo_layout if isinstance(writer, StereoWriter) else ""
        packing = _PACKINGS.get(layout.removeprefix("half-"))
        if packing is not None and codec is formats.PreviewCodec.H264:
            self._tags = {"x264-params": f"frame-packing={packing}"}
        super().__init__(target, timing, audio)

    def encode(self, frame: DepthFrame) -> tuple[VideoFrame, DepthFrame]:
        """Render the preview of a frame; also returns the frame."""
        pixels = self._writer.render(frame.depth, frame.image, frame.spread)
        return _av_frame(pixels, self._codec), frame

    def append(self, encoded: tuple[VideoFrame, DepthFrame]) -> None:
        """Write a frame; with the first one, a comment that says what wrote the file."""
        coded_frame, frame = encoded
        labels = {"comment": f"{COMMENT_PREFIX}{__version__}"}
        labels |= frames.time_code_label(frame.image.time_code, self._timing)
        self._write(coded_frame, frame, labels)


def video_file(
    format_: formats.VideoFormat,
    target: Path | OutputPipe,
    timing: frames.Timing,
    writing: WriterOptions,
    codec: formats.PreviewCodec | None = None,
    audio: AudioTrack | None = None,
) -> VideoFile:
    """The output of a format that is one video: lossless depth, a preview, or stereo pairs.

    ``codec`` and ``audio`` are for the latter two; None for the usual codec, and for no sound.
    """
    if format_ is formats.VideoFormat.MKV:
        return DepthVideoOutput(target, timing, writing)
    image = Format.STEREO if format_ is formats.VideoFormat.STEREO else Format.PREVIEW
    writer = cast("PreviewWriter | StereoWriter", writer_of(image, writing))
    chosen = formats.preview_codec(format_, codec)
    return PreviewVideoOutput(target, timing, writer, codec=chosen, audio=audio)


class SequenceOutput(VideoOutput):
    """One file a frame, in one of the formats of images, each written atomically."""

    def __init__(
        self, image: Format, folder: Path, pattern: str, writing: WriterOptions, guard: Guard
    ) -> None:
        """Prepare files in a folder, named by a pattern for their frames' numbers."""
        self.has_overscan = image.facts.has_overscan
        super().__init__()
        self._image, self._folder, self._pattern = image, folder, pattern
        self._writer, self._guard = writer_of(image, writing), guard
        self._warning, self._warned = "", 0

    def encode(self, frame: DepthFrame) -> tuple[str, ...]:
        """Write the file; in any order."""
        if frame.is_kept:
            return ()
        path = self._folder / numbering.numbered_name(self._pattern, frame.image.index)
        self._guard.check(path)
        with atomic_path(path) as temporary:
            return self._writer.write(frame.depth, temporary, frame.image)

    def append(self, encoded: tuple[str, ...]) -> None:
        """Remember the first warning, and count the frames with one."""
        if encoded:
            self._warning, self._warned = self._warning or encoded[0], self._warned + 1

    def finish(self) -> tuple[str, ...]:
        """Return the first warning, with their number."""
        first = about(f"{self._image}: {self._warned} frames, the first", self._warning)
        return (first,) if self._warned else ()


class SegmentedOutput(VideoOutput):
    """Outputs that follow each other, cut at multiples of a length."""

    def __init__(
        self, opened: Callable[[int], VideoOutput], length_s: float, number: int = 0
    ) -> None:
        """Prepare the output.

        ``opened`` makes the output of a segment by its number, from ``number`` on, to be entered;
        ``length_s`` is seconds from the first frame on.
        """
        super().__init__()
        self._opened, self._length_s, self._number = opened, length_s, number
        self._first_s: float | None = None
        self._passed, self._warnings = 0, list[str]()

    def __enter__(self) -> Self:
        self._output = self.enter_context(self._opened(self._number))
        return self

    def encode(self, frame: DepthFrame) -> tuple[float, Any]:
        """Encode a frame, for whichever segment it falls into; also returns its time in seconds."""
        return frame.time_s, self._output.encode(frame)

    def append(self, encoded: tuple[float, Any]) -> None:
        """Write a frame; complete the segment before if it is the first one of another."""
        time_s, part = encoded
        self._first_s = time_s if self._first_s is None else self._first_s
        passed = int((time_s - self._first_s) // self._length_s)
        if passed > self._passed:
            self._warnings += self._output.finish()
            self.close()
            self._passed, self._number = passed, self._number + 1
            self.__enter__()
        self._output.append(part)

    def finish(self) -> tuple[str, ...]:
        """Complete the last segment, and return the first warning of all, with their number."""
        warnings = [*self._warnings, *self._output.finish()]
        if len(warnings) <= 1:
            return tuple(warnings)
        return (about(f"{len(warnings)} segments, the first", warnings[0]),)
