"""Writing a preview of a video's depth, with the video's audio."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av

from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.storage.guard import Guard
from depthcli.video.audio import AudioTrack
from depthcli.video.av_frame import av_frame
from depthcli.video.codecs import Codec
from depthcli.video.file import VideoFile, video_file
from depthcli.video.output import DepthFrame, VideoOutput
from depthcli.video.pipes import OutputPipe
from depthcli.video.rates import Timing
from depthcli.video.time_code import time_code_label


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
        pixels = self._writer.render(frame.depth, frame.picture, frame.spread)
        return av_frame(pixels, self._codec), frame

    def append(self, encoded: tuple[av.VideoFrame, DepthFrame]) -> None:
        """Write a frame."""
        coded_frame, frame = encoded
        label = time_code_label(frame.picture.time_code, self._timing)
        aspect = frame.picture.pixel_aspect
        self._file.write(coded_frame, frame.time_s, label, pixel_aspect=aspect)

    def finish(self) -> tuple[str, ...]:
        """Complete the file and its audio."""
        return self._file.finish()
