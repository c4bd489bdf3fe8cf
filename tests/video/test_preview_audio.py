"""Audio that a preview cannot take as it is: it never costs the video."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from helpers.videos import with_sound

from depthcli.core.types import DepthMap, Frame
from depthcli.io.formats.preview import PreviewWriter
from depthcli.video.audio import AudioTrack
from depthcli.video.formats import preview_codec
from depthcli.video.frames import Timing
from depthcli.video.outputs import DepthFrame, PreviewVideoOutput
from depthcli.video.source import VideoSource


def write_preview(path: Path, source: Path) -> tuple[str, ...]:
    """Four seconds at 25 frames a second, with the audio of a source; also its warnings."""
    with VideoSource(source) as video:
        assert video.start_s is not None
        audio = AudioTrack(source, video.start_s)
    codec = preview_codec(path.suffix, None)
    timing = Timing(Fraction(25))
    with PreviewVideoOutput(
        path, timing, PreviewWriter(), None, codec=codec, audio=audio
    ) as output:
        for index in range(100):
            frame = Frame(np.zeros((16, 16), np.uint8), timestamp_s=index / 25)
            depth = DepthMap(np.ones((16, 16), np.float32))
            output.append(output.encode(DepthFrame(frame, depth, (0.0, 1.0))))
        return output.finish()


def pictures_and_sound(path: Path) -> tuple[int, str, int, float]:
    """How many frames a file has; codec, rate and end of its sound."""
    with av.open(str(path)) as container:
        sound = container.streams.audio[0].codec_context
        end_s = 0.0
        for frame in container.decode(audio=0):
            end_s = float((frame.pts or 0) * (frame.time_base or 0)) + frame.samples / sound.rate
    with av.open(str(path)) as container:
        return len(list(container.decode(video=0))), sound.name, sound.rate, end_s


@pytest.mark.parametrize("codec", ["pcm_s16le", "pcm_s24le"])
@pytest.mark.parametrize("layout", ["mono", "stereo"])
def test_the_sound_begins_with_the_first_frame(codec: str, layout: str, tmp_path: Path) -> None:
    """PCM is copied into MOV, by whole packets; the first frame is within one."""
    source = with_sound(tmp_path / "a.mkv", codec, layout=layout)
    for start_s in (Fraction(509, 1000), Fraction(1.1), Fraction(1.2), Fraction(1509, 1000)):
        path = tmp_path / f"{start_s.numerator}.mov"
        timing = Timing(Fraction(25))
        audio, coded = AudioTrack(source, start_s), preview_codec(".mov", None)
        with PreviewVideoOutput(
            path, timing, PreviewWriter(), None, codec=coded, audio=audio
        ) as output:
            for index in range(30):
                frame = Frame(np.zeros((16, 16), np.uint8), timestamp_s=index / 25)
                depth = DepthMap(np.ones((16, 16), np.float32))
                output.append(output.encode(DepthFrame(frame, depth, (0.0, 1.0))))
            assert output.finish() == ()
        assert 0 <= tone_begins_s(path) - max(0, 1 - float(start_s)) < 0.025


def tone_begins_s(path: Path) -> float:
    """When the sound of a file becomes loud."""
    with av.open(str(path)) as container:
        rate = container.streams.audio[0].rate
        resampler = av.AudioResampler("flt", "mono", rate)
        for packed in container.decode(audio=0):
            for frame in resampler.resample(packed):
                loud = np.flatnonzero(np.abs(frame.to_ndarray()[0]) > 0.05)
                if loud.size:
                    return float((frame.pts or 0) * (frame.time_base or 0)) + loud[0] / rate
    raise AssertionError(path)


def test_times_that_go_back_end_the_sound_only(tmp_path: Path) -> None:
    parts = [with_sound(tmp_path / f"{name}.ts", "aac", seconds=2) for name in "ab"]
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    (warning,) = write_preview(tmp_path / "p.mp4", joined)
    assert "its times go back" in warning
    count, name, _, end_s = pictures_and_sound(tmp_path / "p.mp4")
    assert (count, name) == (100, "aac")
    assert end_s == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize(
    ("codec", "suffix"), [("pcm_s16le", ".mp4"), ("aac", ".webm"), ("pcm_f32le", ".mov")]
)
def test_audio_that_cannot_be_copied_is_left_out_with_one_warning(
    codec: str, suffix: str, tmp_path: Path
) -> None:
    source = with_sound(tmp_path / "a.mkv", codec)
    (warning,) = write_preview(tmp_path / f"p{suffix}", source)
    assert f"the audio is left out: {codec}" in warning
    with av.open(str(tmp_path / f"p{suffix}")) as container:
        assert not container.streams.audio
