"""A video's depth as a preview for people, with the video's sound."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import av

from depthcli.io.writers.preview import PreviewWriter
from depthcli.video.codecs import Codec
from depthcli.video.coding import coded
from depthcli.video.file import VideoFile, video_file
from depthcli.video.output import VideoFrame, VideoOutput
from depthcli.video.pipes import OutputPipe
from depthcli.video.rates import Timing
from depthcli.video.sound import Sound


@contextmanager
def preview_video(
    target: Path | OutputPipe,
    timing: Timing,
    writer: PreviewWriter,
    inputs: Sequence[Path],
    *,
    codec: Codec = Codec.H264,
    sound: Sound | None = None,
) -> Iterator[VideoOutput]:
    """A preview that appears whole or not at all, or goes into a pipe; inputs are not replaced.

    It ends in ``.mp4``, ``.webm`` or ``.mov``, and the codec is one that this container holds.
    """
    with video_file(target, codec, timing, inputs, sound) as file:
        yield PreviewVideoOutput(file, codec, writer)


class PreviewVideoOutput:
    """Colours for people, in a range that is held steady."""

    def __init__(self, file: VideoFile, codec: Codec, writer: PreviewWriter) -> None:
        self._file = file
        self._codec = codec
        self._writer = writer

    def encode(self, frame: VideoFrame) -> tuple[av.VideoFrame, float]:
        """The preview of a frame."""
        pixels = self._writer.render(frame.depth, frame.picture, frame.spread)
        return coded(pixels, self._codec), frame.time_s

    def append(self, encoded: tuple[av.VideoFrame, float]) -> None:
        """Write it."""
        self._file.write(*encoded, {})

    def finish(self) -> tuple[str, ...]:
        """Complete the file, with its sound."""
        return self._file.finish()
