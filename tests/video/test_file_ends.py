"""Files that are whole, or not, whatever their container states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.container import OutputContainer
from helpers.tiny import write_model
from helpers.videos import flat_frames, write_video

from depthcli.core.types import DepthMap, Frame
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.video.plan import VideoRequest, video_destination
from depthcli.jobs.video.run import video
from depthcli.video.frames import Timing
from depthcli.video.outputs import DepthFrame, DepthVideoOutput
from depthcli.video.source import VideoSource


def write_at(path: Path, places: Sequence[int]) -> Path:
    """Motion JPEG at multiples of 1/25 s; AVI has a chunk without data for each of the others."""
    with av.open(str(path), "w") as output:
        stream = output.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        for pixels, place in zip(flat_frames(range(len(places))), places, strict=True):
            frame = av.VideoFrame.from_ndarray(pixels, "rgb24")
            frame.pts, frame.time_base = place, Fraction(1, 25)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return path


def write_maps(path: Path, times_s: Sequence[float], timing: Timing) -> Path:
    with DepthVideoOutput(path, timing, 1000, None) as output:
        for time_s in times_s:
            depth = DepthMap(np.ones((16, 16), np.float32))
            frame = Frame(np.zeros((16, 16), np.uint8), timestamp_s=time_s)
            output.append(output.encode(DepthFrame(frame, depth, (0.0, 1.0))))
        output.finish()
    return path


def test_dropped_frames_of_an_avi_are_no_missing_end(tmp_path: Path) -> None:
    path = write_at(tmp_path / "a.avi", [*range(10), *range(16, 46)])
    with VideoSource(path) as source:
        assert source.frames_stated == 46
        assert len(list(source.frames())) == 40
        assert source.problem is None


def write_avi(file: OneWay | str, count: int) -> OutputContainer:
    """Motion JPEG in a file that is not closed yet."""
    output = av.open(file, "w", format="avi")
    stream = output.add_stream("mjpeg", rate=25)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
    noise = np.random.default_rng(0)
    for index in range(count):
        pixels = noise.integers(0, 256, (48, 64, 3), np.uint8)
        frame = av.VideoFrame.from_ndarray(pixels, "rgb24")
        frame.pts, frame.time_base = index, Fraction(1, 25)
        output.mux(stream.encode(frame))
    output.mux(stream.encode(None))
    return output


class OneWay:
    """A pipe to write into."""

    def __init__(self) -> None:
        self.data = b""

    def write(self, data: bytes) -> int:
        self.data += data
        return len(data)


def test_an_avi_from_a_pipe_states_no_end(tmp_path: Path) -> None:
    pipe, path = OneWay(), tmp_path / "a.avi"
    write_avi(pipe, 12).close()
    assert pipe.data[4:8] == b"\xff" * 4
    path.write_bytes(pipe.data)
    with VideoSource(path) as source:
        assert source.frames_stated is None
        assert len(list(source.frames())) == 12
        assert source.problem is None


class Removal:
    """A Progress that removes a file after some frames."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def begin(self, _what: str, _total: int | None, _unit: str = "") -> Callable[[int], None]:
        return lambda _count: self._path.unlink(missing_ok=True)


def test_a_source_that_is_removed_during_the_run_costs_no_output(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "clip.mkv", flat_frames(range(40)))
    model = SessionLoader(write_model(tmp_path / "model"), "cpu")
    done = video(
        VideoRequest(str(clip), video_destination(f"{tmp_path}/out/"), model=model), Removal(clip)
    )
    assert done.frames == 40
    assert done.problem
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["clip.depth.mkv", "clip.preview.mp4"]
