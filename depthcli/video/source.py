"""The frames of a video, upright and with their times."""

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream

from depthcli.core.choices import MAX_PIXELS, check_pixel_count
from depthcli.core.pixel_aspect import pixel_aspect_of
from depthcli.core.types import Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.formats.table import LABEL_PREFIX
from depthcli.io.images.read import upright
from depthcli.video.container import open_video, pipe_advice
from depthcli.video.decoder import FrameDecoder
from depthcli.video.frames import FrameSource
from depthcli.video.integrity import is_incomplete_matroska
from depthcli.video.pipes import InputPipe
from depthcli.video.pixels import orientation_of, picture_warnings, rgb_pixels
from depthcli.video.rates import FALLBACK_RATE
from depthcli.video.spans import WHOLE, Span
from depthcli.video.stream_info import stream_info
from depthcli.video.time_code import TimeCode, time_code_after
from depthcli.video.timeline import Timeline

_MISSING_SHARE = 200
_AVI = "avi"
_TRANSPOSED = 5
"""The first EXIF orientation that swaps rows and columns."""


class VideoSource(FrameSource):
    """A video file or a pipe, read from its beginning to its end."""

    width: int  #: columns of an upright frame
    height: int  #: rows of an upright frame
    is_own_depth: bool  #: whether it is depth that depthcli wrote

    def __init__(self, source: str | Path | InputPipe, *, max_pixels: int = MAX_PIXELS) -> None:
        """Open any video that FFmpeg reads, except playlists; larger frames are refused.

        Raises:
            InputError: missing, empty, no video, no frame in it, or too large.
        """
        self._source = Path(source) if isinstance(source, str) else source
        self._path = self._source if isinstance(self._source, Path) else None
        self.paths = () if self._path is None else (self._path,)
        self._container, stream = open_video(self._source)
        self.is_own_depth = any(name.startswith(LABEL_PREFIX) for name in self._container.metadata)
        self._check_size(stream.width, stream.height, max_pixels)
        stated = stream_info(self._container, stream)
        self.rate, self.tick_s = stated.rate, stated.time_base
        self._time_code = stated.time_code
        self.frames_stated = stated.frames if self.paths else None  # in a pipe it is a guess
        no_rate = f"the file states no frame rate; {FALLBACK_RATE} a second is assumed"
        self.warnings = () if stated.is_rate_stated else (no_rate,)
        self._decoder = FrameDecoder(self._container, stream, is_own=self.is_own_depth)
        self._reformatter = VideoReformatter()
        first = self._decoder.next()
        self._check_pipe()
        if first is None:
            self.close()
            raise InputError(
                f"{source} holds no frame that can be decoded: it is damaged",
                pipe_advice(self._source),
            )
        self._timestamps = stated.timestamps
        self._current, self._is_read = first, False
        self._inspect(first, stream, max_pixels)
        self._timeline = Timeline(
            self.rate,
            stated.time_base,
            self._ticks(first),
            is_constant=stated.is_constant,
            failed=self._decoder.pop_failed(self._ticks(first)),
            stated_ticks=stream.start_time,
        )
        if self._container.streams.audio:
            begins_s = (stream.start_time or 0) * stated.time_base
            self.start_s = self._timeline.start_s if stated.timestamps == "pts" else begins_s

    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """Decode the frames of a span; to be called once.

        Frames before and between are decoded too, for exactness, but not converted.

        Returns:
            An iterator of frames. RGB, (H, W, 3): uint8, or uint16 of a video of more than 8 bits,
            rotated and mirrored as the file states; ``index`` counts all frames of the file from 0,
            also damaged ones, which are skipped; ``timestamp_s`` counts from the first frame and
            always increases.

        Raises:
            UsageError: it was called before.
        """
        if self._is_read:
            raise UsageError(f"the frames of {self._source} were read; open it again to repeat it")
        self._is_read = True
        return self._frames(span)

    def _frames(self, span: Span) -> Iterator[Frame]:
        for wanted in span.selected(self._numbers_and_times()):
            if not wanted:
                continue
            try:
                pixels = rgb_pixels(self._current, self._reformatter)
            except av.FFmpegError:
                self.problem = "a frame cannot be converted; the frames before it are done"
                return
            pixels = upright(pixels, self._orientation)
            if pixels.shape[:2] != (self.height, self.width):
                self.problem = "the frames change their size; those before are done"
                return
            yield Frame(
                pixels.copy() if self._orientation > 1 else pixels,
                self._path,
                self._timeline.index,
                float(self._timeline.time_s),
                orientation=self._orientation,
                pixel_aspect=self._pixel_aspect,
                time_code=self._current_time_code(),
            )

    def close(self) -> None:
        """Close the file."""
        self._container.close()

    def _check_size(self, width: int, height: int, max_pixels: int) -> None:
        try:
            check_pixel_count(str(self._source), width, height, max_pixels)
        except InputError:
            self.close()
            raise

    def _inspect(self, first: VideoFrame, stream: VideoStream, max_pixels: int) -> None:
        """Read the properties that only a decoded frame has."""
        self._check_size(first.width, first.height, max_pixels)
        self._orientation = orientation_of(first)
        size = first.width, first.height
        is_turned = self._orientation >= _TRANSPOSED
        self.width, self.height = size[::-1] if is_turned else size
        aspect = stream.sample_aspect_ratio
        self._pixel_aspect = pixel_aspect_of(aspect, is_turned=is_turned)
        self.warnings += tuple(picture_warnings(first))

    def _current_time_code(self) -> TimeCode | None:
        if self._time_code is None:
            return None
        frames = round(self._timeline.time_s * self.rate)
        return time_code_after(self._time_code, frames, self.rate)

    def _numbers_and_times(self) -> Iterator[tuple[int, Fraction]]:
        """Number and time of each frame, while it is the current one."""
        frame: VideoFrame | None = self._current
        while frame is not None:
            self._current = frame
            ticks = self._ticks(frame)
            place = self._timeline.add(ticks, self._decoder.pop_failed(ticks))
            self._report_lost()
            yield place
            frame = self._decoder.next()
            self._check_pipe()
        self._check_end()

    def _ticks(self, frame: VideoFrame) -> int | None:
        """A frame's timestamp that is in order; None if FFmpeg makes up all of them."""
        if self._timestamps is None:
            return None
        return frame.dts if self._timestamps == "dts" else frame.pts

    def _check_pipe(self) -> None:
        if isinstance(self._source, InputPipe):
            self._source.check()

    def _check_end(self) -> None:
        """Compare the decoded frames with what the file states."""
        self._timeline.end(self._decoder.pop_failed())
        self._report_lost()
        read = self._timeline.index + 1
        try:
            is_incomplete = self._decoder.ended_early or (
                self._path is not None and is_incomplete_matroska(self._path)
            )
        except InputError as error:
            self.problem = f"it was changed while it was read: {error}"
            return
        # In MP4, an edit list may hide frames, and its demuxer reports a missing end.
        stated = self.frames_stated if self._container.format.name == _AVI else None
        # By the time of the last frame: the stated number includes dropped frames, without data.
        end = round(self._timeline.time_s * self.rate) + 1
        short = stated is not None and stated - end > max(1, stated // _MISSING_SHARE)
        if short or is_incomplete:
            of = "" if stated is None else f" of {stated}"
            self.problem = f"it is truncated or damaged: it ends after {read}{of} frames"

    def _report_lost(self) -> None:
        if self._timeline.lost:
            self.problem = f"it is damaged: {self._timeline.lost} frames cannot be decoded"
