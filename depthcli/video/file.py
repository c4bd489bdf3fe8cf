"""A video file that is being written, frame after frame, each with its own time."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import av
from av.container import OutputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from depthcli.errors import OutputError
from depthcli.io.storage.atomic import atomic_path
from depthcli.video.codecs import Codec, check_encoder
from depthcli.video.encoder import add_video, new_container
from depthcli.video.pipes import OutputPipe
from depthcli.video.rates import Timing
from depthcli.video.sound import Sound

_LONGEST_STEP = 1 << 30


class VideoFile:
    """Frames of one size with their times, and the sound beside them."""

    _container: OutputContainer | None = None
    _stream: VideoStream | None = None
    _before: VideoFrame | None = None
    _first_s = 0.0

    def __init__(
        self, target: Path | OutputPipe, codec: Codec, timing: Timing, sound: Sound | None = None
    ) -> None:
        """Prepare a file; it is opened with the first frame.

        Args:
            target: written in place; callers make it atomic. Its suffix says the container.
            codec: how frames are compressed.
            timing: rate and clock.
            sound: what is heard; None for nothing.

        Raises:
            OutputError: the codec cannot be written here, or no container counts in such steps.
        """
        check_encoder(codec)
        if not timing.is_countable:
            raise OutputError(
                f"{timing.rate} frames a second cannot be written to a video; choose an image "
                "sequence with --format png16 or --format exr"
            )
        self._target = target
        self._codec = codec
        self._timing = timing
        self._sound = sound

    def write(self, frame: VideoFrame, time_s: float, labels: Mapping[str, str]) -> None:
        """Append a frame of :func:`coded`.

        Args:
            frame: the picture.
            time_s: when it is shown; the first frame's time becomes 0.
            labels: name -> text, kept in the file's header; those of the first frame count.

        Raises:
            OutputError: the codec does not take such frames.
            OSError: the file cannot be written.
        """
        if self._stream is None:
            self._first_s = time_s
            self._open(frame, labels)
        clock = self._timing.clock
        at = round((time_s - self._first_s) / clock)
        if self._before is not None:
            at = max(at, (self._before.pts or 0) + 1)
            while at - (self._before.pts or 0) > _LONGEST_STEP:
                # What MP4 cannot count in one step is held by the same picture again.
                self._encode(self._before, (self._before.pts or 0) + _LONGEST_STEP)
        self._encode(frame, at)

    def finish(self) -> tuple[str, ...]:
        """Complete the file.

        Returns:
            Warnings about the sound, one line each.

        Raises:
            OSError: the file cannot be written.
        """
        if self._container is None or self._stream is None or self._before is None:
            return ()
        end_s = float((self._before.pts or 0) * self._timing.clock + 1 / self._timing.rate)
        if self._sound is not None:
            self._sound.play_until(end_s)
            self._sound.finish()
        self._container.mux(self._stream.encode())
        container, self._container = self._container, None
        container.close()
        self._check_pipe()
        return self._sound.warnings if self._sound is not None else ()

    def close(self) -> None:
        """Let the file go, finished or not."""
        if self._sound is not None:
            self._sound.close()
        if self._container is not None:
            with suppress(av.FFmpegError):
                self._container.close()
            self._container = None

    def _open(self, frame: VideoFrame, labels: Mapping[str, str]) -> None:
        container = self._container = new_container(self._target, self._timing, labels)
        size = frame.width, frame.height
        self._stream = add_video(container, self._codec, self._timing, *size)
        if self._sound is not None:
            self._sound.open(container, self._first_s)
        try:
            container.start_encoding()
        except (av.ArgumentError, av.ExternalError, av.UndefinedError) as error:
            raise OutputError(
                f"{self._codec} video of {frame.width}×{frame.height} pixels cannot be written "
                "here; choose an image sequence with --format png16 or --format exr"
            ) from error

    def _encode(self, frame: VideoFrame, at: int) -> None:
        if self._stream is None or self._container is None:
            raise TypeError(self._stream)
        clock = self._timing.clock
        frame.pts, frame.time_base = at, clock
        frame.duration = max(1, round(1 / (self._timing.rate * clock)))
        if self._sound is not None:
            self._sound.play_until(float(at * clock))
        self._container.mux(self._stream.encode(frame))
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
    inputs: Sequence[Path],
    sound: Sound | None = None,
    *,
    written: Path | None = None,
) -> Iterator[VideoFile]:
    """A file that appears whole or not at all, or a pipe.

    Args:
        target: where it goes; its suffix says the container.
        codec: how frames are compressed.
        timing: rate and clock.
        inputs: files that must not be replaced.
        sound: what is heard; None for nothing.
        written: where it is until it is whole, and stays if the block fails; None for a
            temporary name.
    """
    with ExitStack() as stack:
        if not isinstance(target, OutputPipe):
            target = stack.enter_context(atomic_path(target, inputs=inputs))
        file = VideoFile(written or target, codec, timing, sound)
        try:
            yield file
        finally:
            file.close()
        if written is not None and not isinstance(target, OutputPipe):
            written.replace(target)
