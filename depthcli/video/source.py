"""The frames of a video, upright and with their times."""

import math
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.sidedata.sidedata import Type
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace, Interpolation, VideoReformatter
from av.video.stream import VideoStream

from depthcli.core.arrays import UInt8Array, UInt16Array
from depthcli.core.options import AS_STATED, MAX_PIXELS, Projection, ReadOptions, check_pixel_count
from depthcli.core.types import Frame, pixel_aspect_of
from depthcli.errors import InputError, Message, UsageError
from depthcli.io.formats.table import LABEL_PREFIX
from depthcli.io.images.pixels import full_range, upright
from depthcli.io.images.read import masked
from depthcli.video import frames as clock
from depthcli.video.container import InputPipe, LiveStream, open_video, pipe_advice, video_streams
from depthcli.video.decoder import FrameDecoder, is_incomplete_matroska
from depthcli.video.facts import camera_warnings, focal_lengths, side_data, view_of
from depthcli.video.numbering import is_sequence

# Streams without a container, whose average rate FFmpeg sets to 25 whatever they state.
_RAW_FORMATS = {"cavsvideo", "dirac", "dv", "h261", "h263", "h264", "hevc", "jpeg_pipe",
                "m4v", "mjpeg", "mpegvideo", "mpjpeg", "obu", "vc1", "vvc"}  # fmt: skip

# Containers without presentation times: FFmpeg numbers the packets, also those of B-frames.
_NUMBERED_FORMATS = {"avi", "mxf"}

_AVI = "avi"
_AVI_UNKNOWN_FRAMES = 1 << 30  # as FFmpeg states in an AVI that it writes into a pipe


def _stated_rate(container: InputContainer, stream: VideoStream) -> Fraction | None:
    """Frames a second that a file states, often as a mean; None if it states none."""
    if container.format.name not in _RAW_FORMATS:
        return clock.exact_rate(stream.average_rate or stream.guessed_rate or 0)
    return clock.exact_rate(stream.guessed_rate or 0) if stream.codec_context.framerate else None


def _stated_frames(container: InputContainer, stream: VideoStream, rate: Fraction) -> int | None:
    """Number of frames that a file states, directly or by its length; None if it states neither."""
    if container.format.name == _AVI and stream.frames == _AVI_UNKNOWN_FRAMES:
        return None
    length_s = Fraction(container.duration or 0, av.time_base)
    if stream.duration:
        length_s = stream.duration * (stream.time_base or 1 / rate)
    return stream.frames or round(length_s * rate) or None


_EIGHT_BIT = 8
_UNSPECIFIED = 2
_SD_ROWS = 576
_TOLERANCE = 0.02
# Scales and shears of the display matrices of the EXIF orientations 1 to 8.
_UPRIGHT = ((1, 0, 0, 1), (-1, 0, 0, 1), (-1, 0, 0, -1), (1, 0, 0, -1))
_MATRICES = (*_UPRIGHT, (0, 1, 1, 0), (0, 1, -1, 0), (0, -1, -1, 0), (0, -1, 1, 0))
_EXIF_OF_ANGLE = {90: 8, 180: 3, 270: 6}  # in degrees, counter-clockwise


def rgb_pixels(
    frame: VideoFrame, reformatter: VideoReformatter, *, has_alpha: bool = False
) -> UInt8Array | UInt16Array:
    """A frame converted to RGB from its own colour space and range, not rotated.

    If it states no colour space, that is BT.601 up to 576 rows and BT.709 above, as in players.
    The pixels are (H, W, 3), or (H, W, 4) with alpha: uint8 of 8-bit video, else uint16 up to
    65535. Raises av.FFmpegError if the format cannot be converted.
    """
    is_deep = any(component.bits > _EIGHT_BIT for component in frame.format.components)
    guessed = Colorspace.ITU709 if frame.height > _SD_ROWS else Colorspace.ITU601
    formats = ("rgba", "rgba64le") if has_alpha else ("rgb24", "rgb48le")
    rgb = reformatter.reformat(
        frame,
        format=formats[is_deep],
        src_colorspace=guessed if frame.colorspace == _UNSPECIFIED else None,
        dst_color_range=ColorRange.JPEG,
        interpolation=Interpolation.BICUBIC,
    )
    return rgb.to_ndarray()  # type: ignore[return-value]


def orientation_of(frame: VideoFrame) -> int:
    """The EXIF orientation (1-8) of a frame's display matrix; 1 for other angles."""
    data = side_data(frame, Type.DISPLAYMATRIX)
    if data is None:  # or beside a kind that PyAV does not know, such as that of EXIF
        return _EXIF_OF_ANGLE.get(frame.rotation % 360, 1)
    a, b, _, c, d = np.frombuffer(data, "<i4")[:5].tolist()
    across, down = math.hypot(a, c) or 1, math.hypot(b, d) or 1  # the matrix may scale as well
    shares = a / across, b / down, c / across, d / down
    turns = (np.allclose(shares, matrix, atol=_TOLERANCE) for matrix in _MATRICES)
    return next((number for number, fits in enumerate(turns, start=1) if fits), 1)


_MISSING_SHARE = 200
_RGB = 3
_TRANSPOSED = 5  # the first EXIF orientation that swaps rows and columns


class FrameConverter:
    """Makes upright images of decoded frames, which all have the facts of the first one.

    Attributes:
        width: columns of an upright frame.
        height: rows of an upright frame.
        warnings: one line each about the first frame, but not about its pixels.
    """

    def __init__(
        self, first: VideoFrame, pixel_aspect: Fraction | None, options: ReadOptions
    ) -> None:
        """Read what only a decoded frame states."""
        self._options, self._reformatter = options, VideoReformatter()
        self._orientation = orientation_of(first)
        self._view = rows, columns = view_of(first, options.eye)
        size = len(range(first.width)[columns]), len(range(first.height)[rows])
        is_turned = self._orientation >= _TRANSPOSED
        self.width, self.height = size[::-1] if is_turned else size
        self._pixel_aspect = pixel_aspect_of(pixel_aspect, is_turned=is_turned)
        self._is_begun = False
        self.warnings = tuple(camera_warnings(first, options.eye, options.projection))

    def image(self, decoded: VideoFrame, index: int, time_s: Fraction) -> Frame:
        """A frame, upright; where it is transparent, with the colours around that.

        The first one has the warnings about its pixels. InputError if it cannot be converted, or
        has another size than the first one.
        """
        options, components = self._options, decoded.format.components
        has_alpha = any(one.is_alpha for one in components) and not options.ignore_alpha
        try:
            pixels = rgb_pixels(decoded, self._reformatter, has_alpha=has_alpha)
        except av.FFmpegError as error:
            told = "a frame cannot be converted; the frames before it are done"
            raise InputError(told) from error
        pixels = upright(pixels[self._view], self._orientation)
        rgb, warnings = pixels[..., :_RGB], tuple[str, ...]()
        if rgb.shape[:2] != (self.height, self.width):
            raise InputError("the frames change their size; those before are done")
        is_first, self._is_begun = not self._is_begun, True
        if is_first or options.white_level is not None or options.black_level:
            rgb, warnings = full_range(rgb, None, options.white_level, options.black_level)
        frame = Frame(
            rgb if rgb.flags.c_contiguous else rgb.copy(),
            index=index,
            timestamp_s=float(time_s),
            orientation=self._orientation,
            warnings=warnings,
            pixel_aspect=self._pixel_aspect,
            projection=options.projection or Projection.PINHOLE,
        )
        if has_alpha:
            try:
                frame = masked(frame, pixels[..., _RGB])
            except InputError:  # nothing is seen, as before a fade
                frame = replace(frame, transparent=np.ones(rgb.shape[:2], np.bool_))
        return frame if is_first else replace(frame, warnings=())


class VideoSource(clock.FrameSource):
    """A video file or a pipe, read from its beginning to its end."""

    width: int  #: columns of an upright frame
    height: int  #: rows of an upright frame
    is_own_depth: bool  #: whether it is depth that depthcli wrote
    frames_stated = None

    def __init__(
        self,
        source: str | Path | InputPipe,
        *,
        max_pixels: int = MAX_PIXELS,
        stream: int | None = None,
        options: ReadOptions = AS_STATED,
    ) -> None:
        """Open any video that FFmpeg reads, except playlists.

        Args:
            source: the video.
            max_pixels: larger frames are refused.
            stream: number of the video stream, from 0; None for the one with most frames.
            options: view of a stereo video, levels of 16-bit pixels, projection, and whether
                transparent pixels count.

        Raises:
            InputError: missing, empty, no video, no frame in it, or too large.
            UsageError: there is no such stream or view.
        """
        self._source = Path(source) if isinstance(source, str) else source
        self._path = self._source if isinstance(self._source, Path) else None
        self.paths = () if self._path is None else (self._path,)
        self._container, chosen = open_video(self._source, stream)
        self._is_closed = False
        self.is_own_depth = any(name.startswith(LABEL_PREFIX) for name in self._container.metadata)
        check_pixel_count(str(source), chosen.width, chosen.height, max_pixels)
        rate = _stated_rate(self._container, chosen)
        if rate is None:
            no_rate = f"the file states no frame rate; {clock.FALLBACK_RATE} a second is assumed"
            self.warnings += (no_rate,)
        self.rate = rate or clock.FALLBACK_RATE
        self.tick_s = chosen.time_base or 1 / self.rate
        if self.paths:  # in a pipe it is a guess
            self.frames_stated = _stated_frames(self._container, chosen, self.rate)
        streams = video_streams(self._container)
        if stream is None and len(streams) > 1:
            problem = f"of its {len(streams)} video streams, number {streams.index(chosen)} is read"
            self.warnings += (Message(f"{problem}, and the others are left out", "give {stream}"),)
        self._focal_mm = focal_lengths(self._path, self._container)
        self._time_code = clock.header_time_code(self._container, chosen, self.rate)
        self._decoder = FrameDecoder(self._container, chosen, is_own=self.is_own_depth)
        first = self._decoder.next()
        self._check_pipe()
        if first is None:
            problem = f"{source} holds no frame that can be decoded: it is damaged"
            raise InputError(problem, pipe_advice(self._source))
        self._current, self._is_read = first, False
        self._converter = FrameConverter(first, chosen.sample_aspect_ratio, options)
        self.width, self.height = self._converter.width, self._converter.height
        self.warnings += self._converter.warnings
        self._begin(first, chosen)

    def _begin(self, first: VideoFrame, stream: VideoStream) -> None:
        """Set the clock by the first frame that can be decoded."""
        container = self._container.format.name
        is_raw = container in _RAW_FORMATS
        self._timestamps = None if is_raw else "dts" if container in _NUMBERED_FORMATS else "pts"
        self._timeline = clock.Timeline(
            self.rate,
            self.tick_s,
            self._ticks(first),
            is_constant=is_raw or stream.average_rate == stream.base_rate,
            failed=self._decoder.pop_failed(self._ticks(first)),
            stated_ticks=stream.start_time,
        )
        if self._container.streams.audio:
            begins_s = (stream.start_time or 0) * self.tick_s
            self.start_s = self._timeline.start_s if self._timestamps == "pts" else begins_s

    def frames(self, span: clock.Span = clock.WHOLE) -> Iterator[Frame]:
        """Decode the frames of a span; to be called once.

        They are RGB, (H, W, 3): uint8, or uint16 of a video of more than 8 bits, rotated and
        mirrored as the file states; ``index`` counts all frames of the file from 0, also damaged
        ones, which are skipped; ``timestamp_s`` counts from the first frame and always increases.
        Frames before and between are decoded too, for exactness, but not converted.

        Raises:
            UsageError: it was called before.
        """
        if self._is_read:
            raise UsageError(f"the frames of {self._source} were read", "open it again")
        self._is_read = True
        return self._frames(span)

    def _frames(self, span: clock.Span) -> Iterator[Frame]:
        for wanted in span.selected(self._numbers_and_times()):
            if not wanted:
                continue
            place, code = self._timeline, self._time_code
            since_first = round(place.time_s * self.rate)
            try:
                frame = self._converter.image(self._current, place.index, place.time_s)
            except InputError as error:
                self.problem = str(error)
                return
            self.warnings += frame.warnings
            yield replace(
                frame,
                path=self._path,
                focal_35mm=self._focal_mm[0],
                focal_mm=self._focal_mm[1],
                time_code=clock.time_code_after(code, since_first, self.rate) if code else None,
            )

    def close(self) -> None:
        """Close the file."""
        self._is_closed = True
        self._container.close()

    def _numbers_and_times(self) -> Iterator[tuple[int, Fraction]]:
        """Number and time of each frame, while it is the current one."""
        frame: VideoFrame | None = self._current
        while frame is not None:
            self._current = frame
            ticks = self._ticks(frame)
            self._timeline.has_gaps = self._decoder.has_gaps
            place = self._timeline.add(ticks, self._decoder.pop_failed(ticks))
            self._report_lost()
            yield place
            if self._is_closed:  # FFmpeg would read freed memory
                raise UsageError(f"{self._source} is closed", "read its frames before that")
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
        stated, self.frames_stated = self.frames_stated, read
        is_incomplete = self._decoder.ended_early or (
            self._path is not None and is_incomplete_matroska(self._path, self._container)
        )
        # In MP4, an edit list may hide frames, and its demuxer reports a missing end.
        stated = stated if self._container.format.name == _AVI else None
        # By the time of the last frame: the stated number includes dropped frames, without data.
        end = round(self._timeline.time_s * self.rate) + 1
        short = stated is not None and stated - end > max(1, stated // _MISSING_SHARE)
        if short or is_incomplete:
            of = "" if stated is None else f" of {stated}"
            self.problem = f"it is truncated or damaged: it ends after {read}{of} frames"

    def _report_lost(self) -> None:
        if self._timeline.lost:
            self.problem = f"it is damaged: {self._timeline.lost} frames cannot be decoded"


def open_frames(
    source: Path | InputPipe | LiveStream,
    *,
    rate: Fraction | None = None,
    max_pixels: int = MAX_PIXELS,
    options: ReadOptions = AS_STATED,
    stream: int | None = None,
) -> clock.FrameSource:
    """Open a video, a live stream, or a sequence: a folder, or a pattern (``plate.%04d.exr``).

    ``rate`` is frames a second of a sequence; None for what it states. InputError if it cannot be
    read, or is depth that depthcli wrote; UsageError if a folder holds several sequences.
    """
    if isinstance(source, LiveStream):
        from depthcli.video.live_source import LiveSource  # noqa: PLC0415 - a file needs none

        return LiveSource(source, max_pixels=max_pixels, number=stream, options=options)
    if isinstance(source, Path) and is_sequence(source):
        from depthcli.video.sequence import ImageSequence  # noqa: PLC0415 - a video needs none

        return ImageSequence(source, rate=rate, max_pixels=max_pixels, options=options)
    video = VideoSource(source, max_pixels=max_pixels, stream=stream, options=options)
    if video.is_own_depth:
        video.close()
        problem = f"{source} is depth that depthcli wrote"
        raise InputError(problem, "name the video that it was made of")
    return video
