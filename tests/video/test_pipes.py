"""Videos in pipes: times, and raw frames."""

import io
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from helpers.videos import with_sound

from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError
from depthcli.io.formats.preview import PreviewWriter
from depthcli.video.audio import AudioTrack
from depthcli.video.container import InputPipe, OutputPipe, RawVideo
from depthcli.video.frames import Timing
from depthcli.video.outputs import DepthFrame, PreviewVideoOutput
from depthcli.video.source import VideoSource

FILM = Fraction(24000, 1001)
END_OF_FRAMES = b"the end of the frames"


def write_preview(target: Path | OutputPipe, source: Path, first_s: int, seconds: int) -> None:
    """A preview with the sound of a video from a time on."""
    with VideoSource(source) as video:
        audio = AudioTrack(source, video.start_s or Fraction(0))
    values = np.random.default_rng(0).uniform(1, 9, (64, 64)).astype(np.float32)
    with PreviewVideoOutput(target, Timing(FILM), PreviewWriter(), None, audio=audio) as output:
        for i in range(int(seconds * FILM)):
            picture = Frame(np.zeros((64, 64), np.uint8), timestamp_s=float(first_s + i / FILM))
            depth = DepthMap(np.roll(values, 9 * i), DepthKind.METRIC)
            output.append(output.encode(DepthFrame(picture, depth, (1, 9))))
        if isinstance(target, OutputPipe):
            target.write(END_OF_FRAMES)
        assert output.finish() == ()


@pytest.mark.parametrize(
    ("suffix", "sound"), [(".mp4", "libopus"), (".mp4", "aac"), (".mov", "pcm_s16le")]
)
@pytest.mark.parametrize(
    ("first_s", "seconds"),
    [
        pytest.param(0, 5, id="whole"),
        pytest.param(2, 4, id="from the middle"),
        pytest.param(5, 14, id="after the sound"),
    ],
)
def test_frames_in_a_pipe_have_the_times_of_a_file(
    suffix: str, sound: str, first_s: int, seconds: int, tmp_path: Path
) -> None:
    source = with_sound(tmp_path / "a.mkv", sound)
    write_preview(tmp_path / f"b{suffix}", source, first_s, seconds)
    stream = BytesIO()
    write_preview(OutputPipe(stream, suffix), source, first_s, seconds)
    before, after = stream.getvalue().split(END_OF_FRAMES)
    assert len(before) > len(after) / 4  # fragments do not wait for the end
    assert frames_of(BytesIO(before + after)) == frames_of(tmp_path / f"b{suffix}")


def frames_of(video: Path | BytesIO) -> list[tuple[int | None, int]]:
    """Time and duration of each frame, in ticks."""
    file = video if isinstance(video, BytesIO) else str(video)
    with av.open(file) as container:
        return [(frame.pts, frame.duration) for frame in container.decode(video=0)]


HEIGHT, WIDTH, FRAMES = 4, 6, 3
RGB = np.arange(FRAMES * HEIGHT * WIDTH * 3, dtype=np.uint8).reshape(FRAMES, HEIGHT, WIDTH, 3)
DEEP = np.linspace(0, 65535, FRAMES * HEIGHT * WIDTH).astype("<u2").reshape(RGB.shape[:3])


def read(data: bytes, pixel_format: str) -> tuple[VideoSource, list[Any]]:
    raw = RawVideo(WIDTH, HEIGHT, pixel_format, Fraction(30000, 1001))
    with VideoSource(InputPipe(io.BytesIO(data), raw)) as source:
        return source, list(source.frames())


@pytest.mark.parametrize(
    ("pixel_format", "sent", "pixels"),
    [
        ("bgr24", RGB[..., ::-1], RGB),
        ("rgb24", RGB, RGB),
        ("gray", RGB[..., 0], RGB[..., :1]),
        ("gray16le", DEEP, DEEP[..., None]),
    ],
)
def test_pixels_and_times_are_those_that_were_sent(
    pixel_format: str, sent: np.ndarray[Any, Any], pixels: np.ndarray[Any, Any]
) -> None:
    source, frames = read(sent.tobytes(), pixel_format)
    assert (source.rate, source.problem, len(frames)) == (Fraction(30000, 1001), None, FRAMES)
    for number, frame in enumerate(frames):
        expected = np.broadcast_to(pixels[number], (HEIGHT, WIDTH, 3))
        np.testing.assert_array_equal(frame.pixels, expected)
        assert frame.timestamp_s == pytest.approx(number * 1001 / 30000, abs=1e-9)


def test_an_incomplete_last_frame_is_told() -> None:
    source, frames = read(RGB.tobytes()[:-1], "rgb24")
    assert len(frames) == FRAMES - 1
    assert source.problem is not None


def test_less_than_a_frame_is_an_error() -> None:
    with pytest.raises(InputError, match="raw"):
        read(RGB.tobytes()[:30], "rgb24")
