"""Writing a video file, frame by frame, with a time for each."""

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
import numpy.typing as npt
from av.container import OutputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace, Interpolation
from av.video.stream import VideoStream

from depthcli.errors import OutputError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.guard import Guard
from depthcli.video.audio import AudioTrack
from depthcli.video.container import OutputPipe
from depthcli.video.decoder import state_number
from depthcli.video.formats import CONTAINERS, DEPTH_PIXELS, ENCODINGS, Codec, check_encoder
from depthcli.video.frames import Timing

_SEQUENCE_ADVICE = "choose an image sequence with {format} png16 or exr"
_BT709 = 1
_KEYFRAME_INTERVAL_S = 2
_MAX_GOP = 250
_MAX_ASPECT = 1000
_FRAGMENTS = "+frag_keyframe+empty_moov+default_base_moof"


def _new_container(
    target: Path | OutputPipe, timing: Timing, labels: Mapping[str, str]
) -> OutputContainer:
    """A new file without streams; its container follows from the suffix, and is reproducible.

    Labels, name -> text, are written to the header as metadata.

    Raises:
        OSError: it cannot be created.
    """
    options = {"fflags": "+bitexact"}
    name, is_pipe = CONTAINERS[target.suffix.lower()], isinstance(target, OutputPipe)
    if name in {"mp4", "mov"}:
        # In a pipe, fragments: an index at the beginning could only be written after all frames.
        layout = _FRAGMENTS if is_pipe else "+faststart"
        ticks = str(timing.time_base.denominator)
        options |= {"movflags": layout, "video_track_timescale": ticks}
    if not isinstance(target, OutputPipe):
        target.touch()  # problems with the folder are reported before the work begins
    file = target if is_pipe else str(target)
    container = av.open(file, "w", format=name, container_options=options)
    container.metadata.update(labels)
    return container


def _add_video(
    container: OutputContainer, codec: Codec, timing: Timing, width: int, height: int
) -> VideoStream:
    """Add a video stream for frames of a size."""
    if codec is Codec.AV1:
        os.environ.setdefault("SVT_LOG", "0")  # else it writes to standard error
    encoding = ENCODINGS[codec]
    options = encoding.options_for(width, height)
    stream = cast(
        "VideoStream", container.add_stream(encoding.encoder, rate=timing.rate, options=options)
    )
    stream.width, stream.height = width, height
    stream.pix_fmt = encoding.pixel_format
    stream.time_base = timing.time_base
    context = stream.codec_context
    context.time_base = timing.time_base
    keyframe_interval = max(1, min(round(_KEYFRAME_INTERVAL_S * timing.rate), _MAX_GOP))
    context.gop_size = 1 if encoding.is_intra_only else keyframe_interval
    if encoding.pixel_format != DEPTH_PIXELS:
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = ColorRange.MPEG
    return stream


class VideoFile:
    """Frames of one size with their times, and the audio beside them."""

    _container: OutputContainer | None = None
    _stream: VideoStream | None = None
    _before: VideoFrame | None = None
    _first_s = 0.0

    def __init__(
        self,
        target: Path | OutputPipe,
        codec: Codec,
        timing: Timing,
        audio: AudioTrack | None = None,
    ) -> None:
        """Prepare a file; it is opened with the first frame.

        Args:
            target: written in place; callers make it atomic. Its suffix chooses the container.
            codec: of the frames.
            timing: rate and time base.
            audio: the audio track; None for none.

        Raises:
            OutputError: there is no encoder.
        """
        check_encoder(codec)
        self._target = target
        self._codec = codec
        self._timing = timing
        self._audio = audio

    def write(
        self,
        frame: VideoFrame,
        time_s: float,
        labels: Mapping[str, str],
        number: int | None = None,
        pixel_aspect: float = 1.0,
    ) -> None:
        """Append a frame of :func:`~depthcli.video.encoder.av_frame`.

        Args:
            frame: its pixels.
            time_s: when it is shown; the first frame's time becomes 0.
            labels: name -> text, metadata for the file's header; used with the first frame only.
            number: of the frame, to be stated with it in Matroska; None for no statement.
            pixel_aspect: width by height of a pixel; used with the first frame only.

        Raises:
            OutputError: the encoder does not support such frames.
            OSError: the file cannot be written.
        """
        if self._stream is None:
            self._first_s = time_s
            self._open(frame, labels, pixel_aspect)
        time_base = self._timing.time_base
        at = round((time_s - self._first_s) / time_base)
        if self._before is not None:
            at = max(at, (self._before.pts or 0) + 1)
        self._encode(frame, at, number)

    def finish(self) -> tuple[str, ...]:
        """Complete the file.

        Returns:
            Warnings about the audio, one line each.

        Raises:
            OSError: the file cannot be written.
        """
        if self._container is None or self._stream is None or self._before is None:
            return ()
        end_s = float((self._before.pts or 0) * self._timing.time_base + 1 / self._timing.rate)
        if self._audio is not None:
            self._audio.mux_until(end_s)
        self._container.mux(self._stream.encode())
        container, self._container = self._container, None
        container.close()
        self._check_pipe()
        return self._audio.warnings if self._audio is not None else ()

    def close(self) -> None:
        """Close the file, finished or not."""
        if self._audio is not None:
            self._audio.close()
        if self._container is not None:
            with suppress(av.FFmpegError):
                self._container.close()
            self._container = None

    def _open(self, frame: VideoFrame, labels: Mapping[str, str], pixel_aspect: float) -> None:
        container = self._container = _new_container(self._target, self._timing, labels)
        size = frame.width, frame.height
        self._stream = _add_video(container, self._codec, self._timing, *size)
        if pixel_aspect != 1:  # PyAV cannot state it in the header of Matroska and WebM
            aspect = Fraction(pixel_aspect).limit_denominator(_MAX_ASPECT)
            self._stream.codec_context.sample_aspect_ratio = aspect
        if self._audio is not None:
            self._audio.open(container, self._first_s)
            options = container.container_options
            if self._audio.begins_soon and _FRAGMENTS in options.get("movflags", ""):
                # The header waits for the first fragment, and states where the audio begins.
                options["movflags"] += "+delay_moov"
        try:
            container.start_encoding()
        except (av.ArgumentError, av.ExternalError, av.UndefinedError) as error:
            problem = (
                f"no {self._codec} video of {frame.width}×{frame.height} pixels can be written"
            )
            raise OutputError(problem, _SEQUENCE_ADVICE) from error

    def _encode(self, frame: VideoFrame, at: int, number: int | None = None) -> None:
        if self._stream is None or self._container is None:
            raise TypeError(self._stream)
        time_base = self._timing.time_base
        frame.pts, frame.time_base = at, time_base
        frame.duration = max(1, round(1 / (self._timing.rate * time_base)))
        if self._audio is not None:
            self._audio.mux_until(float(at * time_base))
        packets = self._stream.encode(frame)
        if number is not None:
            for packet in packets:  # FFV1 has no delay, so it is the frame's
                state_number(packet, number)
        self._container.mux(packets)
        self._before = frame
        self._check_pipe()

    def _check_pipe(self) -> None:
        if isinstance(self._target, OutputPipe):
            self._target.check()


@contextmanager
def video_file(
    target: Path | OutputPipe,
    codec: Codec,
    timing: Timing,
    guard: Guard | None,
    audio: AudioTrack | None = None,
) -> Iterator[VideoFile]:
    """A video file that is written atomically, or a pipe.

    Args:
        target: the output; its suffix chooses the container.
        codec: of the frames.
        timing: rate and time base.
        guard: of existing files; None to replace any.
        audio: the audio track; None for none.
    """
    with ExitStack() as stack:
        if not isinstance(target, OutputPipe):
            target = stack.enter_context(atomic_path(target, guard=guard))
        file = VideoFile(target, codec, timing, audio)
        try:
            yield file
        finally:
            file.close()


def av_frame(pixels: npt.NDArray[np.uint16] | npt.NDArray[np.uint8], codec: Codec) -> VideoFrame:
    """A PyAV frame in the pixel format of a codec; thread-safe.

    Pixels are (H, W) uint16 for FFV1, else (H, W, 3) RGB uint8. For codecs with chroma subsampling,
    an odd row or column is doubled.
    """
    wanted = ENCODINGS[codec].pixel_format
    if wanted == DEPTH_PIXELS:
        return VideoFrame.from_ndarray(np.ascontiguousarray(pixels, np.uint16), DEPTH_PIXELS)
    return VideoFrame.from_ndarray(_even(pixels), "rgb24").reformat(
        format=wanted,
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        dst_color_trc=None,
        interpolation=Interpolation.BICUBIC | Interpolation.ACCURATE_RND,
        threads=1,
    )


def _even(pixels: npt.NDArray[np.generic]) -> npt.NDArray[np.uint8]:
    height, width = pixels.shape[:2]
    if height % 2 or width % 2:
        pixels = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return np.ascontiguousarray(pixels, np.uint8)
