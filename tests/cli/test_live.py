"""``depthcli video`` of streams that have no end."""

import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterable
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.videos import NTSC, encode, flat_frames, write_video
from helpers.web import Camera, free_port

from depthcli.errors import InputError, UsageError
from depthcli.video.container import live_stream
from depthcli.video.depth_video import DepthVideo
from depthcli.video.live_source import LiveSource


def wait_for(is_true: Callable[[], bool]) -> None:
    until = time.monotonic() + 50
    while not is_true():
        assert time.monotonic() < until
        time.sleep(0.02)


def send(camera: Camera, levels: Iterable[int]) -> None:
    """Frames of which FFmpeg takes several before it knows a stream."""
    for level in levels:
        camera.levels.put(level)


def opened(camera: Camera, said: list[str] | None = None) -> LiveSource:
    stream = live_stream(camera.url, is_live=True, say=[].append if said is None else said.append)
    assert stream is not None
    return LiveSource(stream)


def test_the_newest_frame_comes_first_and_late_ones_are_counted() -> None:
    with Camera(is_endless=False) as camera:
        send(camera, range(0, 60, 10))
        with opened(camera) as source:
            frames = source.frames()
            first = next(frames)
            send(camera, (70, 80, 200))
            wait_for(lambda: source.counts.received == 9)
            newest = next(frames)
        assert (newest.index, int(newest.pixels.mean())) == (8, 200)
        assert (source.counts.dropped, first.timestamp_s) == (7, 0)
        assert newest.timestamp_s


def test_a_lost_stream_is_opened_again() -> None:
    messages: list[str] = []
    with Camera(is_endless=False) as camera:
        send(camera, [10] * 9)
        with opened(camera, messages) as source:
            frames = source.frames()
            next(frames)
            camera.levels.put(None)
            wait_for(lambda: camera.connections == 2)
            send(camera, [90] * 9)
            assert any(int(frame.pixels.mean()) == 90 for frame in frames)
            assert (source.counts.reconnections, len(messages)) == (1, 2)


def test_a_stream_that_does_not_come_back_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("depthcli.video.live_source.MOST_ATTEMPTS", 1)
    camera = Camera(is_endless=False)
    with camera:
        send(camera, [10] * 9)
        source = opened(camera)
        wait_for(lambda: source.counts.received == 9)
    assert [frame.index for frame in source.frames()][-1] == 8
    assert source.problem is not None


class Answer(Camera):
    """An address that answers with the same bytes, whose number it does not state."""

    body = b""

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.end_headers()
        request.wfile.write(self.body)


def test_a_transport_stream_is_read(tmp_path: Path) -> None:
    clip = encode(tmp_path / "a.ts", flat_frames([100] * 50), NTSC, "mpeg2video", "yuv420p")
    with Answer() as server:
        server.body = clip.read_bytes()
        with opened(server) as source:
            assert abs(int(next(source.frames()).pixels.mean()) - 100) <= 2
            assert source.rate == NTSC


def test_an_address_without_end_asks_for_live(cli: Cli) -> None:
    with Answer() as server:
        done = cli("video", server.url)
    assert (done.returncode, b"--live" in done.stderr) == (1, True)


def test_an_address_of_rtsp_is_connected_to(cli: Cli) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        process = cli.started("video", f"rtsp://127.0.0.1:{server.getsockname()[1]}/a")
        server.settimeout(20)
        client, _ = server.accept()
        with client:
            assert client.recv(4) == b"OPTI"  # OPTIONS, the first request of a session
        stderr = process.communicate(timeout=50)[1]
    assert (process.returncode, stderr.count(b"\n")) == (1, 1)


def test_a_playlist_names_no_file_of_this_machine(tmp_path: Path) -> None:
    secret = encode(tmp_path / "a.ts", flat_frames([9] * 50), NTSC, "mpeg2video", "yuv420p")
    start = "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\n"
    with Answer() as server, Answer() as segments:
        segments.body = secret.read_bytes()
        stream = live_stream(server.url.replace("video.mjpg", "live.m3u8"))
        assert stream is not None
        server.body = f"{start}{segments.url.replace('mjpg', 'ts')}\n#EXT-X-ENDLIST\n".encode()
        with LiveSource(stream) as source:
            assert next(source.frames()).index == 0
        server.body = f"{start}file://{secret}\n#EXT-X-ENDLIST\n".encode()
        stream.stop.clear()
        with pytest.raises(InputError):
            LiveSource(stream)


def test_names_of_streams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.platform", "linux")
    camera = live_stream("0")
    assert (camera.address, camera.device_format) == ("/dev/video0", "v4l2")
    (tmp_path / "0").mkdir()
    assert live_stream("0") is None
    assert live_stream("http://host/clip.mp4") is None
    named = live_stream("rtsp://me:secret@host/1?key=secret")
    assert str(named) == "rtsp://host/1"
    with pytest.raises(UsageError):
        live_stream("clip.mp4", is_live=True)


def test_ctrl_c_completes_the_files(cli: Cli) -> None:
    with Camera() as camera:
        process = cli.started(
            *("video", camera.url, "--live", "-o", "out/", "--json", "--segment", "0.2s"),
            *("--format", "mkv", "--format", "npy"),
        )
        wait_for(lambda: len(list(cli.folder.glob("out/*.mkv"))) >= 2)
        process.send_signal(signal.SIGINT)
        output, stderr = process.communicate(timeout=50)
    assert (process.returncode, stderr) == (0, b"")
    facts = json.loads(output)
    assert facts["outputs"][0] == "out/live.depth.%04d.mkv"
    assert facts["look_ahead"] == 0
    names = {path.name for path in cli.folder.glob("out/*.mkv")}
    assert names == {f"live.depth.{number:04d}.mkv" for number in range(len(names))}
    steps = [step for name in names for step in DepthVideo(cli.folder / "out" / name).steps()]
    assert len(steps) == facts["frames"] == len(list(cli.folder.glob("out/*.npy")))
    assert facts["live"]["received"] >= facts["frames"] + facts["live"]["dropped"]


@pytest.mark.parametrize("is_raw", [True, False], ids=["raw frames", "MPEG-TS"])
@pytest.mark.parametrize("is_stopped", [True, False], ids=["Ctrl-C", "end of the pipe"])
def test_a_pipe_is_read_live_until_it_ends_or_ctrl_c(
    is_raw: bool, is_stopped: bool, cli: Cli, tmp_path: Path
) -> None:
    raw = ("--raw", "64x48:gray@30000/1001") if is_raw else ()
    words = ("video", "-", "--live", *raw, "-o", "out/", "--json", "--format", "mkv")
    process = cli.started(*words, "--format", "npy", stdin=subprocess.PIPE)
    data = bytes(range(100)) * 64 * 48
    if not is_raw:
        levels = flat_frames(range(100))
        data = encode(tmp_path / "a.ts", levels, NTSC, "mpeg2video", "yuv420p").read_bytes()
    assert process.stdin is not None
    process.stdin.write(data)
    process.stdin.flush()
    wait_for(lambda: bool(list(cli.folder.glob("out/*.npy"))))
    if is_stopped:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=50)  # while the pipe is open
    output, stderr = process.communicate(timeout=50)
    assert (process.returncode, stderr) == (0, b"")
    facts = json.loads(output)
    assert facts["fps"] == "30000/1001"
    steps = list(DepthVideo(cli.folder / facts["outputs"][0]).steps())
    assert len(steps) == facts["frames"] == len(list(cli.folder.glob("out/*.npy")))
    assert facts["live"]["received"] == facts["frames"] + facts["live"]["dropped"] or is_stopped


def is_open(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


def test_a_page_shows_the_newest_preview_until_the_video_ends(cli: Cli) -> None:
    port = free_port()
    with Camera() as camera:
        page = ("--show", str(port), "--colormap", "gray")
        words = ("video", camera.url, "--live", "-o", "a.mkv", *page)
        process = cli.started(*words)
        wait_for(lambda: is_open(port))
        with urlopen(f"http://127.0.0.1:{port}/") as answer:
            assert b"/stream" in answer.read()
        foreign = Request(f"http://127.0.0.1:{port}/stream", headers={"Host": f"evil.org:{port}"})
        with pytest.raises(HTTPError):
            urlopen(foreign)  # noqa: S310 - of HTTP
        with urlopen(f"http://127.0.0.1:{port}/stream", timeout=50) as stream:
            for _ in range(3):
                assert stream.readline() == b"--frame\r\n"
                assert stream.readline() == b"Content-Type: image/jpeg\r\n"
                size = int(stream.readline().split()[1])
                assert stream.readline() == b"\r\n"
                image = cv2.imdecode(np.frombuffer(stream.read(size), np.uint8), cv2.IMREAD_COLOR)
                assert image.shape == (48, 64, 3)
                assert stream.readline() == b"\r\n"
            taken = cli("video", "no.mp4", "--show", str(port))
            assert (taken.returncode, len(taken.stderr.splitlines())) == (2, 1)
            process.send_signal(signal.SIGINT)
            stream.read()  # to its end
        _, stderr = process.communicate(timeout=50)
    assert (process.returncode, b"no effect" in stderr) == (0, False)


def test_segments_of_a_video_hold_all_of_its_frames(inside: Cli) -> None:
    write_video(inside.folder / "clip.avi", flat_frames(range(0, 250, 10)))
    assert inside("video", "clip.avi", "-o", "whole.mkv").returncode == 0
    assert inside("video", "clip.avi", "-o", "part.mkv", "--segment", "0.4s").returncode == 0
    parts = sorted(inside.folder.glob("part.*.mkv"))
    assert [path.name for path in parts] == [f"part.{number:04d}.mkv" for number in range(3)]
    steps = [list(DepthVideo(path).steps()) for path in parts]
    assert [len(segment) for segment in steps] == [10, 10, 5]
    np.testing.assert_array_equal(
        [step for segment in steps for step in segment],
        list(DepthVideo(inside.folder / "whole.mkv").steps()),
    )
    for wrong in (("--segment", "0"), ("-o", "-", "--segment", "1m"), ("--live",)):
        inside("video", "clip.avi", *wrong, code=2)
