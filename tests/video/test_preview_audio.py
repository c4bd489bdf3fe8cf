"""Audio that a preview cannot take as it is: it never costs the video."""

from __future__ import annotations

import os
from fractions import Fraction
from typing import TYPE_CHECKING

import av
import numpy as np
import pytest
from videos import with_sound

from depthcli.core.types import DepthMap, Frame
from depthcli.io.formats.preview import PreviewWriter
from depthcli.video.audio import AudioTrack
from depthcli.video.audio_output import AudioOutput
from depthcli.video.codecs import preview_codec
from depthcli.video.output import DepthFrame
from depthcli.video.preview_output import preview_video
from depthcli.video.rates import Timing
from depthcli.video.source import VideoSource

if TYPE_CHECKING:
    from pathlib import Path


def write_preview(path: Path, source: Path) -> tuple[str, ...]:
    """Four seconds at 25 frames a second, with the audio of a source; also its warnings."""
    with VideoSource(source) as video:
        assert video.start_s is not None
        audio = AudioTrack(source, video.start_s)
    codec = preview_codec(path.suffix, None)
    timing = Timing(Fraction(25))
    with preview_video(path, timing, PreviewWriter(), (), codec=codec, audio=audio) as output:
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


@pytest.mark.parametrize("codec", ["pcm_s16le", "pcm_s24le", "pcm_f32le", "mp2"])
@pytest.mark.parametrize("layout", ["mono", "stereo"])
def test_the_sound_begins_with_the_first_frame(codec: str, layout: str, tmp_path: Path) -> None:
    """PCM is copied into MOV, the others are encoded; the first frame is within a packet."""
    source = with_sound(tmp_path / "a.mkv", codec, layout=layout)
    for start_s in (Fraction(509, 1000), Fraction(1.1), Fraction(1.2), Fraction(1509, 1000)):
        path = tmp_path / f"{start_s.numerator}.mov"
        timing = Timing(Fraction(25))
        audio, coded = AudioTrack(source, start_s), preview_codec(".mov", None)
        with preview_video(path, timing, PreviewWriter(), (), codec=coded, audio=audio) as output:
            for index in range(30):
                frame = Frame(np.zeros((16, 16), np.uint8), timestamp_s=index / 25)
                depth = DepthMap(np.ones((16, 16), np.float32))
                output.append(output.encode(DepthFrame(frame, depth, (0.0, 1.0))))
            assert output.finish() == ()
        assert tone_begins_s(path) == pytest.approx(max(0, 1 - float(start_s)), abs=0.004)


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


@pytest.mark.parametrize("codec", ["aac", "mp2"])  # copied, and encoded
def test_times_that_go_back_end_the_sound_only(codec: str, tmp_path: Path) -> None:
    parts = [with_sound(tmp_path / f"{name}.ts", codec, seconds=2) for name in "ab"]
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    warning = "the audio is damaged, so the preview lacks it at least in part: its times go back"
    assert write_preview(tmp_path / "p.mp4", joined) == (warning,)
    count, name, _, end_s = pictures_and_sound(tmp_path / "p.mp4")
    assert (count, name) == (100, "aac")
    assert end_s == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".mov"])
def test_sound_that_changes_its_channels_and_rate_is_heard(suffix: str, tmp_path: Path) -> None:
    joined = tmp_path / "joined.ts"
    first = with_sound(tmp_path / "a.ts", "mp2", seconds=2, layout="stereo")
    second = with_sound(tmp_path / "b.ts", "mp2", seconds=1, begin_s=3, rate=44_100)
    joined.write_bytes(first.read_bytes() + second.read_bytes())
    assert write_preview(tmp_path / f"p{suffix}", joined) == ()
    count, _, rate, end_s = pictures_and_sound(tmp_path / f"p{suffix}")
    assert (count, rate) == (100, 48_000)
    assert end_s == pytest.approx(4, abs=0.1)


@pytest.mark.parametrize(
    ("rate", "expected"), [(192_000, 48_000), (48_048, 48_000), (44_100, 44_100)]
)
@pytest.mark.parametrize("suffix", [".mp4", ".mov"])
def test_rates_that_an_encoder_does_not_take_are_resampled(
    rate: int, expected: int, suffix: str, tmp_path: Path
) -> None:
    source = with_sound(tmp_path / "a.mkv", "pcm_f32le", rate=rate)
    assert write_preview(tmp_path / f"p{suffix}", source) == ()
    count, name, found, end_s = pictures_and_sound(tmp_path / f"p{suffix}")
    assert (count, name, found) == (100, "aac", expected)
    assert end_s == pytest.approx(4, abs=0.1)


@pytest.mark.parametrize(
    ("suffix", "rate", "expected"),
    [(".mp4", 22_050, "mp3float"), (".mp4", 11_025, "aac"), (".mov", 11_025, "mp3float")],
)
def test_mp3_is_copied_where_the_container_knows_its_rate(
    suffix: str, rate: int, expected: str, tmp_path: Path
) -> None:
    source = with_sound(tmp_path / "a.avi", "mp3", rate=rate)
    assert write_preview(tmp_path / f"p{suffix}", source) == ()
    count, name, found, end_s = pictures_and_sound(tmp_path / f"p{suffix}")
    assert (count, name, found) == (100, expected, rate)
    assert end_s == pytest.approx(4, abs=0.15)


def test_a_full_disk_is_no_damage_of_the_audio(tmp_path: Path) -> None:
    if not os.path.exists("/dev/full"):  # noqa: PTH110 - a device
        pytest.skip("no /dev/full here")
    source = with_sound(tmp_path / "a.mkv", "pcm_s16le")
    with av.open(str(source)) as video, open("/dev/full", "wb", buffering=0) as full:  # noqa: PTH123
        output = av.open(full, "w", format="mp4", options={"movflags": "frag_every_frame"})
        sound = AudioOutput(output, video.streams.audio[0], Fraction(0))
        packets = video.demux(audio=0)
        with pytest.raises(OSError, match="No space left"):
            any(map(sound.write, packets))
