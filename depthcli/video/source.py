"""The frames of a video or of numbered images, upright and with their times."""

import mmap
import re
import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from depthcli.core.options import AS_STATED, MAX_PIXELS, ReadOptions, check_pixel_count
from depthcli.core.types import Frame, Window
from depthcli.errors import InputError, Message, UsageError, about
from depthcli.io.exr.image import read_exr_image
from depthcli.io.images.heif import boxes
from depthcli.io.images.read import read_image
from depthcli.io.media import COMMENT_PREFIX, LABEL_PREFIX, is_exr
from depthcli.video import decoder, frames as clock, numbering
from depthcli.video.container import InputPipe, LiveStream, open_video, pipe_advice, video_streams

# Streams without a container, whose average rate FFmpeg sets to 25 whatever they state.
_RAW_FORMATS = {"cavsvideo", "dirac", "dv", "h261", "h263", "h264", "hevc", "jpeg_pipe",
                "m4v", "mjpeg", "mpegvideo", "mpjpeg", "obu", "vc1", "vvc"}  # fmt: skip

# Containers without presentation times: FFmpeg numbers the packets, also those of B-frames.
_NUMBERED_FORMATS = {"avi", "mxf"}

_AVI = "avi"
_AVI_UNKNOWN_FRAMES = 1 << 30  # as FFmpeg states in an AVI that it writes into a pipe
_MISSING_SHARE = 200


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


class VideoSource(clock.FrameSource):
    """A video file or a pipe, read from its beginning to its end."""

    width: int  #: columns of an upright frame
    height: int  #: rows of an upright frame
    is_own: bool  #: whether depthcli wrote it: depth, or its preview
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
        tags = self._container.metadata
        is_own_depth = any(name.startswith(LABEL_PREFIX) for name in tags)
        self.is_own = is_own_depth or any(t.startswith(COMMENT_PREFIX) for t in tags.values())
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
        self._decoder = decoder.FrameDecoder(self._container, chosen, is_own=is_own_depth)
        first = next(self._decoder.frames, None)
        self._check_pipe()
        if first is None:
            problem = f"{source} holds no frame that can be decoded: it is damaged"
            raise InputError(problem, pipe_advice(self._source))
        self._first, self._is_read = first, False
        self._converter = decoder.FrameConverter(first, chosen.sample_aspect_ratio, options)
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
        code = self._time_code
        for index, time_s, image in span.select(self._timed()):
            since_first = round(time_s * self.rate)
            try:
                frame = self._converter.image(image, index, time_s)
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

    def _timed(self) -> Iterator[tuple[int, Fraction, VideoFrame]]:
        """Number, time in seconds and image of each frame."""
        frame: VideoFrame | None = self._first
        while frame is not None:
            ticks = self._ticks(frame)
            self._timeline.has_gaps = self._decoder.has_gaps
            index, time_s = self._timeline.add(ticks, self._decoder.pop_failed(ticks))
            self._report_lost()
            yield index, time_s, frame
            if self._is_closed:  # FFmpeg would read freed memory
                raise UsageError(f"{self._source} is closed", "read its frames before that")
            frame = next(self._decoder.frames, None)
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
        container_count, self.frames_stated = self.frames_stated, read
        is_incomplete = self._decoder.ended_early or (
            self._path is not None and decoder.is_incomplete_matroska(self._path, self._container)
        )
        # In MP4, an edit list may hide frames, and its demuxer reports a missing end.
        container_count = container_count if self._container.format.name == _AVI else None
        # By the time of the last frame: the stated number includes dropped frames, without data.
        end = round(self._timeline.time_s * self.rate) + 1
        short = container_count is not None and container_count - end > max(
            1, container_count // _MISSING_SHARE
        )
        if short or is_incomplete:
            of = "" if container_count is None else f" of {container_count}"
            self.problem = f"it is truncated or damaged: it ends after {read}{of} frames"

    def _report_lost(self) -> None:
        if self._timeline.lost:
            self.problem = f"it is damaged: {self._timeline.lost} frames cannot be decoded"


_FOCAL_35MM = "camera.focal_length.35mm_equivalent"
_LENS = re.compile(r"focal|lens", re.IGNORECASE)
_LENGTH = re.compile(r"(\d+(?:\.\d+)?) ?(?:mm)?", re.ASCII)
_LENS_LENGTH = re.compile(r"(\d+(?:\.\d+)?) ?mm", re.ASCII)  # as in "back camera 6.765mm f/1.78"
_TEXT, _FLOAT32, _FLOAT64 = 1, 23, 24  # well-known types of QuickTime's metadata


def focal_lengths(
    path: Path | None, container: InputContainer
) -> tuple[float | None, float | None]:
    """35-mm equivalent and lens length of a video in mm; of a pipe, what FFmpeg passes on."""
    tags = dict(container.metadata)
    if path is not None and container.format.name.startswith("mov"):
        tags |= _quicktime_tags(path)
    equivalent_mm = lens_mm = None
    for key, text in tags.items():
        if key.lower().endswith(_FOCAL_35MM):
            match = _LENGTH.fullmatch(text.strip())
            equivalent_mm = float(match[1]) or None if match else None
        elif _LENS.search(key) and (match := _LENS_LENGTH.search(text)):
            lens_mm = float(match[1])
    return equivalent_mm, lens_mm


def _quicktime_tags(path: Path) -> dict[str, str]:
    """QuickTime's metadata of the file and its tracks, of which FFmpeg leaves out most."""
    tags: dict[str, str] = {}
    with (
        suppress(OSError, ValueError),  # of a pipe with a name, which has no map
        path.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
    ):
        for moov in boxes(data, b"moov", 0, len(data)):
            for place in (moov, *boxes(data, b"trak", *moov)):
                for meta in boxes(data, b"meta", *place):
                    tags = dict(_items(data, *meta)) | tags  # the first of a name counts
    return tags


def _items(data: mmap.mmap, start: int, end: int) -> Iterator[tuple[str, str]]:
    """Names and values of a metadata box."""
    names = []
    for at, stop in boxes(data, b"keys", start, end):
        names += [data[i + 4 : j] for i, j in boxes(data, None, at + 8, stop, head=4)]
    for ilst in boxes(data, b"ilst", start, end):
        for at, stop in boxes(data, None, *ilst):
            number = int.from_bytes(data[at - 4 : at])
            for i, j in boxes(data, b"data", at, stop):
                if 0 < number <= len(names) and i + 8 <= j:
                    name = names[number - 1].decode("utf-8", "replace")
                    yield name, _value(int.from_bytes(data[i : i + 4]), data[i + 8 : j])


def _value(kind: int, data: bytes) -> str:
    if kind == _TEXT:
        return data.decode("utf-8", "replace")
    if (kind, len(data)) in {(_FLOAT32, 4), (_FLOAT64, 8)}:
        return f"{struct.unpack('>f' if kind == _FLOAT32 else '>d', data)[0]:g}"
    return f"{int.from_bytes(data[:8])}"


_SHOWN = 10
_TRIES = 10  #: images that are asked for their frame rate
_CUT = "images with more overscan than the first one, which is cut off"


class ImageSequence(clock.FrameSource):
    """Numbered images, read one after the other."""

    numbers_follow_times = True

    def __init__(
        self,
        path: Path,
        *,
        rate: Fraction | None = None,
        max_pixels: int = MAX_PIXELS,
        options: ReadOptions = AS_STATED,
    ) -> None:
        """Find the images of a folder or of a pattern such as ``%04d``.

        ``rate`` is frames a second; None for that of the first EXR. Larger images than
        ``max_pixels`` are refused. InputError if there is none, UsageError if the folder holds
        more than one sequence.
        """
        files = numbering.find_images(path)
        self.paths = tuple(file.path for file in files)
        if numbering.are_times(files):
            self.name_numbers = [file.number for file in files]
            files = list(map(numbering.NumberedImage, range(len(files)), self.paths))
        self._files = files
        self._max_pixels, self._options = max_pixels, options
        self._overscan: Window | None = None  # that of the first image
        file_rate = rate or stated_rate(self.paths)
        self.rate = file_rate or clock.FALLBACK_RATE
        self.tick_s = Fraction(1, self.rate.numerator)
        self.frames_stated = len(self._files)
        self.warnings = tuple(self._warnings(is_timed=file_rate is not None))

    @property
    def numbers_stated(self) -> tuple[int, int]:
        """Number of the first and of the last image."""
        return self._files[0].number, self._files[-1].number

    def frames(self, span: clock.Span = clock.WHOLE) -> Iterator[Frame]:
        """Read the images of a span; ``index`` is the number in the name."""
        cut, warnings, sizes_px = 0, self.warnings, None
        for frame in self._readable(span):
            found_px = (frame.width, frame.height), frame.display_size_px
            if sizes_px is None:
                sizes_px, self._overscan = found_px, _overscan(frame)
                warnings += tuple(about(str(frame.path), warning) for warning in frame.warnings)
                self.warnings = warnings
            if found_px != sizes_px:
                self.problem = f"{frame.path} has another size; the images before it are done"
                return
            if frame.windows and frame.windows.valid != frame.windows.data:
                cut += 1
                self.warnings = (*warnings, f"{_CUT}: {cut}, the last of them: {frame.path}")
            yield frame

    def _readable(self, span: clock.Span) -> Iterator[Frame]:
        """The images of a span that can be read."""
        unreadable = list[int]()
        for number, time_s, path in span.select(self._timed()):
            try:
                yield self._read(number, time_s, path)
            except InputError as error:
                unreadable.append(number)
                problem = f"{len(unreadable)} of its images cannot be read ({_listed(unreadable)})"
                self.problem = f"{problem}, the last of them: {error}"

    def _timed(self) -> Iterator[tuple[int, Fraction, Path]]:
        """Number, time in seconds and file of each image."""
        first = self._files[0].number
        return ((number, (number - first) / self.rate, path) for number, path in self._files)

    def count(self, span: clock.Span) -> int:
        """Number of images in a span."""
        return sum(1 for _ in span.select(self._timed()))

    def _read(self, number: int, time_s: Fraction, path: Path) -> Frame:
        limit, options = self._max_pixels, self._options
        if is_exr(path.name):
            overscan = self._overscan
            image = read_exr_image(path, max_pixels=limit, overscan=overscan, options=options)
        else:
            image = read_image(path, max_pixels=limit, **options._asdict())
        return replace(image, index=number, timestamp_s=float(time_s))

    def _warnings(self, *, is_timed: bool) -> Iterator[str]:
        if not is_timed:
            yield Message(f"no frame rate is given; {clock.FALLBACK_RATE} is assumed", "give {fps}")
        if self.name_numbers:
            yield f"numbers such as {self.paths[0].stem} are times; frames are counted from 0"
        ends = [(a + 1, b - 1) for a, b in pairwise(file.number for file in self._files)]
        gaps = [f"{a}" if a == b else f"{a}–{b}" for a, b in ends if a <= b]
        if gaps:
            yield f"missing frames: {_listed(gaps)}; the other frames keep their times"


def stated_rate(paths: Sequence[Path]) -> Fraction | None:
    """The frame rate of the first EXR that can be read, exact; None if none."""
    for path in (path for path in paths[:_TRIES] if is_exr(path.name)):
        from depthcli.io.exr.file import read_exr_rate  # noqa: PLC0415 - OpenEXR is slow to load

        with suppress(InputError):  # which reading its pixels reports
            rate = read_exr_rate(path)
            return rate and (clock.exact_rate(rate) or rate)
    return None


def _listed(numbers: Sequence[object]) -> str:
    """The first of several numbers, in a message."""
    more = f" and {len(numbers) - _SHOWN} more" if len(numbers) > _SHOWN else ""
    return ", ".join(map(str, numbers[:_SHOWN])) + more


def _overscan(frame: Frame) -> Window:
    """The window of a frame's pixels, relative to the corner of its display window."""
    if frame.windows is None:
        return Window(0, 0, frame.width, frame.height)
    left, top = frame.windows.display[:2]
    return frame.windows.pixels.moved(-left, -top)


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
    read, or depthcli wrote it; UsageError if a folder holds several sequences.
    """
    if isinstance(source, LiveStream):
        from depthcli.video.live_source import LiveSource  # noqa: PLC0415 - a file needs none

        return LiveSource(source, max_pixels=max_pixels, number=stream, options=options)
    if isinstance(source, Path) and numbering.is_sequence(source):
        return ImageSequence(source, rate=rate, max_pixels=max_pixels, options=options)
    video = VideoSource(source, max_pixels=max_pixels, stream=stream, options=options)
    if video.is_own:
        video.close()
        problem = f"{source} was written by depthcli"
        raise InputError(problem, "name the video that it was made of")
    return video
