"""The newest frame of a live stream, whenever one is asked for."""

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import av
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from depthcli.core.options import AS_STATED, MAX_PIXELS, ReadOptions, check_pixel_count
from depthcli.core.types import Frame
from depthcli.errors import InputError, UsageError
from depthcli.video.container import STREAMED_FORMATS, LiveStream, open_video, video_streams
from depthcli.video.decoder import FrameConverter, FrameDecoder
from depthcli.video.frames import FALLBACK_RATE, WHOLE, FrameSource, Span, exact_rate

MOST_ATTEMPTS = 10  #: to open a lost stream again, before it is given up
_LONGEST_PAUSE_S = 30.0
_TIMEOUT_S = 10.0
_POLL_S = 0.1
_TICK_S = Fraction(1, 1000)
_HLS = "hls"
_MOST_AHEAD_S = 60.0
# A playlist may name other hosts, but no file of this one.
_NETWORK = {
    "protocol_whitelist": "rtp,srtp,udp,tcp,tls,http,https,httpproxy,crypto",
    "format_whitelist": STREAMED_FORMATS,
    "rtsp_flags": "prefer_tcp",
}


def _opened(stream: LiveStream, number: int | None) -> tuple[InputContainer, VideoStream]:
    """The container and its video stream; av.FFmpegError if it cannot be opened."""
    if stream.pipe is not None:
        return open_video(stream.pipe, number)
    options = _NETWORK if stream.device_format is None else {}
    timeouts = _TIMEOUT_S, _TIMEOUT_S
    container = av.open(
        stream.address, "r", format=stream.device_format, options=options, timeout=timeouts
    )
    streams = video_streams(container)
    if number is not None and number < len(streams):
        return container, streams[number]
    best = container.streams.best("video")
    if number is None and best is not None:
        return container, best  # type: ignore[return-value] # the best of a kind is of that kind
    container.close()
    raise UsageError(f"{stream} has {len(streams)} video streams", option="stream")


@dataclass(slots=True)
class LiveCounts:
    """Numbers about a stream so far."""

    received: int = 0  #: frames that came
    dropped: int = 0  #: frames that were replaced by newer ones before they were asked for
    reconnections: int = 0  #: how often it was opened again


class LiveSource(FrameSource):
    """The newest frames of a stream, with the times of their arrival, from the first one on.

    A thread of its own decodes the stream and keeps the newest frame. A lost stream is opened
    again, after pauses of 1, 2, 4 s and so on. ``index`` counts all frames that came, so that
    dropped ones are missing in the numbers.

    Attributes:
        counts: frames that came and were dropped.
    """

    def __init__(
        self,
        stream: LiveStream,
        *,
        max_pixels: int = MAX_PIXELS,
        number: int | None = None,
        options: ReadOptions = AS_STATED,
    ) -> None:
        """Open a stream, and wait for its first frame.

        Args as of :class:`depthcli.video.source.VideoSource`. InputError if it cannot be opened,
        has no frame, or is too large.
        """
        self.counts, self.rate = LiveCounts(), FALLBACK_RATE
        self.paths, self.frames_stated, self.tick_s = (), None, _TICK_S
        self._stream, self._number = stream, number
        self._pixel_aspect: Fraction | None = None
        self._news = threading.Condition()
        #: number among all frames that came, monotonic time of its arrival in seconds, image
        self._newest: tuple[int, float, VideoFrame] | None = None
        self._error: BaseException | None = None
        self._has_ended = False
        # A daemon, as FFmpeg may wait for data of a stream that is not wanted any more.
        threading.Thread(target=self._run, daemon=True).start()
        first = self._next()
        if first is None:
            raise InputError(f"{stream} ended before its first frame")
        image = first[2]
        check_pixel_count(str(stream), image.width, image.height, max_pixels)
        self._first = first
        self._converter = FrameConverter(image, self._pixel_aspect, options)
        self.warnings = self._converter.warnings

    def frames(self, span: Span = WHOLE) -> Iterator[Frame]:
        """Convert the newest frame whenever one is asked for; as of :class:`FrameSource`."""
        for number, time_s, image in span.select(self._timed(), is_live=True):
            try:
                frame = self._converter.image(image, number, time_s)
            except InputError as error:
                self.problem = str(error)
                break
            self.warnings += frame.warnings
            yield frame
        self._stream.stop.set()

    def _timed(self) -> Iterator[tuple[int, Fraction, VideoFrame]]:
        frame: tuple[int, float, VideoFrame] | None = self._first
        ticks, first_s = -1, self._first[1]
        while frame is not None:
            number, now_s, image = frame
            ticks = max(ticks + 1, round((now_s - first_s) / float(_TICK_S)))
            yield number, ticks * _TICK_S, image
            frame = self._next()

    def close(self) -> None:
        """Stop the stream."""
        self._stream.stop.set()

    def _next(self) -> tuple[int, float, VideoFrame] | None:
        """Wait for a frame that was not returned yet; None when the stream ended or was stopped."""
        stop = self._stream.stop
        with self._news:
            while self._newest is None and not (self._has_ended or stop.is_set()):
                self._news.wait(_POLL_S)  # the event does not notify
            if stop.is_set():
                return None
            frame, self._newest = self._newest, None
        if frame is None and self._error is not None:
            raise self._error
        return frame

    def _run(self) -> None:
        try:
            self._read()
        except BaseException as error:  # noqa: BLE001 - raised by _next
            self._error = error
        with self._news:
            self._has_ended = True
            self._news.notify()

    def _read(self) -> None:
        attempts, stop = 0, self._stream.stop
        while not stop.is_set():
            before, reason = self.counts.received, "it ended"
            try:
                if self._read_once():
                    return
            except av.ExitError:
                reason = f"no data for {_TIMEOUT_S:.0f} s"
            except av.FFmpegError as error:
                reason = error.strerror or str(error)
            if not self.counts.received:
                raise InputError(f"{self._stream} cannot be opened: {reason}")
            attempts = 1 if self.counts.received > before else attempts + 1
            if attempts > MOST_ATTEMPTS:
                self.problem = f"the stream was lost, {MOST_ATTEMPTS} attempts to open it failed"
                return
            pause_s = min(2.0 ** (attempts - 1), _LONGEST_PAUSE_S)
            self._stream.say(
                f"{self._stream} was lost ({reason}); attempt {attempts} of {MOST_ATTEMPTS} to "
                f"open it again in {pause_s:.0f} s"
            )
            stop.wait(pause_s)

    def _read_once(self) -> bool:
        """Read the stream until it is lost; True if it is over, as a recording or when stopped."""
        container, stream = _opened(self._stream, self._number)
        with container:
            rate = stream.average_rate or stream.guessed_rate or 0  # the latter of raw frames
            if not self.counts.received:
                self.rate = exact_rate(rate) or FALLBACK_RATE
                self._pixel_aspect = stream.sample_aspect_ratio
            # HLS comes in parts of seconds, whose frames would be late all at once.
            is_hls, self._origin_s = container.format.name == _HLS, float("inf")
            decoder, before = FrameDecoder(container, stream), self.counts.received
            for frame in decoder.frames:
                if is_hls and frame.time is not None:
                    self._wait_until(frame.time)
                if self._stream.stop.is_set():
                    return True
                if self.counts.received == before > 0:
                    self.counts.reconnections += 1
                    self._stream.say(f"{self._stream} is back")
                with self._news:
                    self.counts.dropped += self._newest is not None
                    self._newest = self.counts.received, time.monotonic(), frame
                    self.counts.received += 1
                    self._news.notify()
            if self._stream.pipe is not None:
                self._stream.pipe.check()
                return True
            return container.duration is not None and not decoder.ended_early

    def _wait_until(self, time_s: float) -> None:
        """Wait until a frame is due by its time stamp, from the first one on, unless that jumps."""
        now_s = time.monotonic()
        ahead_s = self._origin_s + time_s - now_s
        if abs(ahead_s) > _MOST_AHEAD_S:
            self._origin_s = now_s - time_s
        elif ahead_s > 0:
            self._stream.stop.wait(ahead_s)
