"""Previews through pipes, and their audio."""

import io
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from helpers.videos import with_sound, write_preview_video

from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.guard import is_own
from depthcli.video.audio import AudioTrack
from depthcli.video.container import InputPipe, OutputPipe, RawVideo
from depthcli.video.formats import VideoFormat, preview_codec
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
    with PreviewVideoOutput(target, Timing(FILM), PreviewWriter(), audio=audio) as output:
        for i in range(int(seconds * FILM)):
            image = Frame(np.zeros((64, 64), np.uint8), timestamp_s=float(first_s + i / FILM))
            depth = DepthMap(np.roll(values, 9 * i), DepthKind.METRIC)
            output.append(output.encode(DepthFrame(image, depth, (1, 9))))
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


def read(data: bytes, pixel_format: str) -> tuple[VideoSource, list[Any]]:
    raw = RawVideo(WIDTH, HEIGHT, pixel_format, Fraction(30000, 1001))
    with VideoSource(InputPipe(io.BytesIO(data), raw)) as source:
        return source, list(source.frames())


def test_an_incomplete_last_frame_is_told_and_an_only_one_an_error() -> None:
    source, frames = read(RGB.tobytes()[:-1], "rgb24")
    assert len(frames) == FRAMES - 1
    assert source.problem is not None
    with pytest.raises(InputError, match="raw"):
        read(RGB.tobytes()[:30], "rgb24")


def write_with_audio(
    path: Path, source: Path, first_s: float = 0.0, seconds: int = 4
) -> tuple[str, ...]:
    """A preview of 25 frames a second, with the audio of a source; the result are its warnings."""
    with VideoSource(source) as video:
        audio = AudioTrack(source, video.start_s)
    codec = preview_codec(VideoFormat(path.suffix[1:]))
    maps = [np.ones((16, 16), np.float32)] * (25 * seconds)
    return write_preview_video(path, maps, Fraction(25), first_s, codec=codec, audio=audio)


def heard(path: Path) -> tuple[str, float, float]:
    """Codec of a file's sound, when it becomes loud, and when it ends, in seconds."""
    with av.open(str(path)) as container:
        stream = container.streams.audio[0]
        loud_s, end_s = None, 0.0
        for frame in container.decode(stream):
            level = np.abs(frame.to_ndarray().astype(float))
            start_s = float(frame.pts * frame.time_base)
            end_s = start_s + frame.samples / frame.sample_rate
            if loud_s is None and level.max() > (0.05 if level.max() < 2 else 1500):
                loud_s = start_s
        return stream.codec_context.name, loud_s or 0.0, end_s


@pytest.mark.parametrize(
    ("source", "codec", "preview", "expected"),
    [
        ("a.mp4", "aac", "p.mp4", "aac"),
        ("a.mkv", "libopus", "p.webm", "opus"),
        ("a.mkv", "pcm_s16le", "p.mov", "pcm_s16le"),
        ("a.avi", "mp3", "p.mp4", "mp3float"),  # the decoder of MP3
        ("a.mkv", "mp3", "p.mov", "mp3float"),
    ],
)
@pytest.mark.parametrize("begin_s", [0, 7])
@pytest.mark.parametrize("first_s", [0.0, 0.48])
def test_the_sound_comes_along_and_stays_in_time(
    source: str,
    codec: str,
    preview: str,
    expected: str,
    first_s: float,
    begin_s: int,
    tmp_path: Path,
) -> None:
    path = with_sound(tmp_path / source, codec, begin_s=begin_s)
    out = tmp_path / preview
    assert write_with_audio(out, path, first_s, seconds=2) == ()
    assert is_own(out)
    name, loud_s, end_s = heard(out)
    assert name == expected
    assert loud_s == pytest.approx(1 - first_s, abs=0.06)
    assert end_s == pytest.approx(2, abs=0.1)


def test_times_that_go_back_end_the_sound_only(tmp_path: Path) -> None:
    parts = [with_sound(tmp_path / f"{name}.ts", "aac", seconds=2) for name in "ab"]
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    (warning,) = write_with_audio(tmp_path / "p.mp4", joined)
    assert "its times go back" in warning
    name, _, end_s = heard(tmp_path / "p.mp4")
    assert (name, end_s) == ("aac", pytest.approx(2, abs=0.1))
    assert len(frames_of(tmp_path / "p.mp4")) == 100


@pytest.mark.parametrize(
    ("codec", "suffix"), [("pcm_s16le", ".mp4"), ("aac", ".webm"), ("pcm_f32le", ".mov")]
)
def test_audio_that_cannot_be_copied_is_left_out_with_one_warning(
    codec: str, suffix: str, tmp_path: Path
) -> None:
    source = with_sound(tmp_path / "a.mkv", codec)
    (warning,) = write_with_audio(tmp_path / f"p{suffix}", source)
    assert f"the audio is left out: {codec}" in warning
    with av.open(str(tmp_path / f"p{suffix}")) as container:
        assert not container.streams.audio
