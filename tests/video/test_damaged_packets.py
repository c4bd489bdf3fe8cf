"""Damaged and missing packets, and the ends of files."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.tiny import write_model
from helpers.videos import NTSC, damage_frames, encode, flat_frames, write_depth_video, write_video

from depthcli.errors import InputError
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.video.plan import VideoRequest, video_destination
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.source import VideoSource

_TS_PACKET_BYTES = 188


def random_steps(count: int) -> np.ndarray[Any, np.dtype[np.uint16]]:
    return np.random.default_rng(0).integers(1, 65536, (count, 48, 64), dtype=np.uint16)


def write_other(path: Path, count: int, **options: str) -> Path:
    options = {"g": "1"} | options
    return encode(path, random_steps(count), NTSC, "ffv1", "gray16le", options=options)


@pytest.mark.parametrize(("count", "damaged"), [(1, 0), (10, 0), (10, 5)])
def test_a_damaged_frame_is_never_taken_for_depth(count: int, damaged: int, tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    write_depth_video(path, (random_steps(count) / 1000).astype(np.float32))
    damage_frames(path, damaged)
    decoded: list[Any] = []
    with pytest.raises(InputError):
        decoded.extend(DepthVideo(path).steps())
    assert len(decoded) == damaged
    for steps, expected in zip(decoded, random_steps(count), strict=False):
        np.testing.assert_array_equal(steps, expected)
    if count == 1:
        with pytest.raises(InputError):
            VideoSource(path)
        return
    with VideoSource(path) as source:
        assert [frame.index for frame in source.frames()] == [*{*range(count)} - {damaged}]
        assert source.problem == "it is damaged: 1 frames cannot be decoded"


def test_frames_after_a_damaged_one_are_left_out_up_to_the_keyframe(tmp_path: Path) -> None:
    path = write_other(tmp_path / "a.mkv", 12, g="4")
    damage_frames(path, 5)
    with VideoSource(path) as source:
        assert [frame.index for frame in source.frames()] == [*range(5), *range(8, 12)]
        assert source.problem == "it is damaged: 3 frames cannot be decoded"


@pytest.mark.parametrize("options", [{"slicecrc": "0", "level": "3"}, {"level": "1"}])
def test_ffv1_without_checksums_is_read(options: dict[str, str], tmp_path: Path) -> None:
    path = write_other(tmp_path / "a.mkv", 20, **options)
    decoded = list(DepthVideo(path).steps())
    np.testing.assert_array_equal(decoded, random_steps(20))


@pytest.mark.parametrize("codec", ["mpeg2video", "libx264"])
@pytest.mark.parametrize("lost", [1, 3, 9])
def test_lost_packets_of_a_transport_stream_are_no_missing_end(
    codec: str, lost: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(60)]
    path = encode(tmp_path / "a.ts", images, Fraction(25), codec, "yuv420p")
    whole = path.read_bytes()
    middle = len(whole) // _TS_PACKET_BYTES // 2
    for begin in range(middle, middle + 12):
        end = begin + lost
        path.write_bytes(whole[: begin * _TS_PACKET_BYTES] + whole[end * _TS_PACKET_BYTES :])
        with VideoSource(path) as source:
            frames = list(source.frames())
            times = [round((frame.timestamp_s or 0) * 25, 3) for frame in frames]
            assert times == [frame.index for frame in frames]
            assert (len(times), times[-1]) == (60 - len(set(range(60)) - set(times)), 59)
            missing = 60 - len(times)
            problem = f"it is damaged: {missing} frames cannot be decoded" if missing else None
            assert source.problem == problem


@pytest.mark.parametrize("codec", ["mpeg2video", "libx264"])
def test_all_frames_of_joined_transport_streams_are_read(codec: str, tmp_path: Path) -> None:
    """Recorders join files with ``cat``; the demuxer marks the packet before the joint."""
    paths = [
        encode(tmp_path / f"{n}.ts", flat_frames([n] * 10), Fraction(10), codec, "yuv420p")
        for n in (40, 200)
    ]
    path = tmp_path / "joined.ts"
    path.write_bytes(b"".join(part.read_bytes() for part in paths))
    with VideoSource(path) as source:
        levels = [int(frame.pixels[9, 9, 0]) for frame in source.frames()]
        assert source.problem is None
    np.testing.assert_allclose(levels, [40] * 10 + [200] * 10, atol=3)


def test_dropped_frames_of_an_avi_are_no_missing_end(tmp_path: Path) -> None:
    numbers, frames = [*range(10), *range(16, 46)], flat_frames(range(40))
    path = tmp_path / "a.avi"  # which has a chunk without data for each frame that is missing
    encode(path, frames, Fraction(25), "mjpeg", "yuvj420p", numbers=numbers)
    with VideoSource(path) as source:
        assert source.frames_stated == 46
        assert len(list(source.frames())) == 40
        assert source.problem is None


def test_an_avi_from_a_pipe_states_no_end(tmp_path: Path) -> None:
    data, path = bytearray(), tmp_path / "a.avi"
    pipe = SimpleNamespace(write=lambda part: data.extend(part) or len(part))
    noise = np.random.default_rng(0).integers(0, 256, (12, 48, 64, 3), np.uint8)
    encode(pipe, noise, Fraction(25), "mjpeg", "yuvj420p", container="avi")
    assert data[4:8] == b"\xff" * 4
    path.write_bytes(data)
    with VideoSource(path) as source:
        assert source.frames_stated is None
        assert len(list(source.frames())) == 12
        assert source.problem is None


def test_a_source_that_is_removed_during_the_run_costs_no_output(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "clip.mkv", flat_frames(range(40)))
    model = SessionLoader(write_model(tmp_path / "model"), "cpu")
    removal = SimpleNamespace(begin=lambda *_: lambda _count: clip.unlink(missing_ok=True))
    request = VideoRequest(str(clip), video_destination(f"{tmp_path}/out/"), model=model)
    done = video(request, removal)
    assert done.frames == 40
    assert done.problem
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["clip.depth.mkv", "clip.preview.mp4"]
