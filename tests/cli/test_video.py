"""``depthcli video``, run from the built wheel as a user runs it."""

import json
import os
import signal
import time
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli, finished, unmeasured
from helpers.folders import here, printed
from helpers.tiny import write_model
from helpers.videos import NTSC, encode, flat_frames, write_ramp, write_video

from depthcli.cli.commands.video import parse_span
from depthcli.errors import UsageError
from depthcli.io.depth.read import read_metadata
from depthcli.video.depth_video import DepthVideo
from depthcli.video.frames import Point

CAMERA = {"hfov_deg": 60.0}


@pytest.fixture(scope="module")
def long_video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video that takes long enough to be interrupted."""
    folder = tmp_path_factory.mktemp("long")
    noise = np.random.default_rng(0).integers(0, 256, (96, 128, 3), np.uint8)
    return write_video(folder / "long.avi", [noise] * 500)


def test_without_options_lossless_depth_and_a_preview_beside_the_video(cli: Cli) -> None:
    write_ramp(cli.folder / "clip.mp4")
    done = cli("video", "clip.mp4")
    assert (done.returncode, done.stderr) == (0, b"")
    assert here(cli) == {"clip.mp4", "clip.depth.mkv", "clip.preview.mp4"}
    assert b"24 frames at 30000/1001 fps" in done.stdout
    video = DepthVideo(cli.folder / "clip.depth.mkv")
    assert (video.rate, video.labels["model"]) == (NTSC, "tiny")
    middles = [float(depth.values[24, 32]) for depth in video]
    assert len(middles) == 24
    assert (np.diff(middles[::4]) > 0).all()
    capture = cv2.VideoCapture(str(cli.folder / "clip.preview.mp4"))
    assert capture.get(cv2.CAP_PROP_FPS) == 30000 / 1001
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 24


def test_a_cut_video_is_written_as_far_as_it_goes(cli: Cli) -> None:
    path = write_video(cli.folder / "cut.avi", flat_frames(range(60)))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    done = cli("video", "cut.avi", "--out", "a.mkv", "--json", code=1)
    (facts,) = printed(done)
    assert facts["status"] == "incomplete"
    assert 5 < facts["frames"] < 60
    (line,) = done.stderr.decode().splitlines()
    assert f"ends after {facts['frames']} of 60 frames" in line
    assert len(list(DepthVideo(cli.folder / "a.mkv").steps())) == facts["frames"]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--start", "soon"), "is not a time"),
        (("--every", "0"), "is not a step"),
        (("--smooth", "-1"), "0 or greater"),
        (("--focal-px", "500", "--hfov", "60"), "not both"),
        (("--format", "gif"), "gif"),
    ],
)
def test_wrong_usage(inside: Cli, options: tuple[str, ...], reason: str) -> None:
    (inside.folder / "clip.mp4").write_bytes(b"never read")
    done = inside("video", "clip.mp4", *options, code=2)
    (line,) = done.stderr.decode().splitlines()
    assert reason in line
    assert here(inside) == {"clip.mp4"}


def test_a_video_flows_through_pipes(cli: Cli) -> None:
    encode(cli.folder / "in.mkv", flat_frames(range(9)), NTSC, "mpeg4", "yuv420p")
    piped = cli("video", "-", "-o", "-", stdin=(cli.folder / "in.mkv").read_bytes())
    assert (piped.returncode, b"9 frames" in piped.stderr) == (0, True)
    (cli.folder / "out.mkv").write_bytes(piped.stdout)
    assert cli("video", "in.mkv", "-o", "file.mkv").returncode == 0
    steps = [list(DepthVideo(cli.folder / name).steps()) for name in ("out.mkv", "file.mkv")]
    np.testing.assert_array_equal(*steps)
    assert here(cli) == {"in.mkv", "out.mkv", "file.mkv"}


def test_a_reader_that_leaves_ends_a_pipe_in_silence(cli: Cli, long_video: Path) -> None:
    running = cli.started("video", str(long_video), "-o", "-", "--quiet")
    assert running.stdout.read(4) == b"\x1aE\xdf\xa3"
    running.stdout.close()
    assert (running.stderr.read(), running.wait(timeout=60)) == (b"", 1)


@pytest.mark.parametrize(
    ("formats", "which"),
    [(("mkv", "mp4"), signal.SIGINT), (("webm",), signal.SIGHUP), (("mkv",), signal.SIGTERM)],
)
def test_an_interrupted_run_leaves_no_half_video(
    cli: Cli, long_video: Path, formats: tuple[str, ...], which: signal.Signals
) -> None:
    (cli.folder / "long.avi").hardlink_to(long_video)
    options = [word for name in formats for word in ("--format", name)]
    running = cli.started("video", "long.avi", "--out", "out/", *options)
    until = time.monotonic() + 30
    while time.monotonic() < until and not list((cli.folder / "out").rglob("*")):
        time.sleep(0.02)
    running.send_signal(which)
    running.communicate(timeout=30)
    assert running.returncode == 128 + which
    assert list((cli.folder / "out").iterdir()) == []


@pytest.mark.parametrize("name", ["mkv", "mp4", "png16"])
def test_a_full_disk_is_an_error_and_leaves_nothing(cli: Cli, name: str) -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (64, 96, 3), dtype=np.uint8) for _ in range(60)]
    write_video(cli.folder / "noise.avi", images)
    limited = (
        "import resource, sys; from depthcli.cli.app import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (900, 900))\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    command = cli.command("video", "noise.avi", "--out", "out/", "--format", name)
    command[1:3] = ["-c", limited]
    done = finished(command, cli.folder, env=unmeasured(cli.environment))
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert here(cli) == {"noise.avi"}


@pytest.mark.parametrize(
    ("word", "bare", "point"),
    [
        ("12.5", False, Point(Fraction("12.5"))),
        ("12.5s", True, Point(Fraction("12.5"))),
        (".5s", False, Point(Fraction(1, 2))),
        ("3.", False, Point(Fraction(3))),
        ("1:02.5", False, Point(Fraction("62.5"))),
        ("1:00:01", True, Point(Fraction(3601))),
        ("300f", False, Point(Fraction(300), in_frames=True)),
        ("2", True, Point(Fraction(2), in_frames=True)),
    ],
)
def test_places_in_a_video(word: str, bare: bool, point: Point) -> None:
    options = (None, None, word) if bare else (word, None, None)
    span = parse_span(*options)
    assert (span.every if bare else span.start) == point


@pytest.mark.parametrize("word", ["-1", "1e3", "1.5f", "1:2f", "a", "1:2:3:4", "nan", "٣"])
def test_words_that_are_no_place(word: str) -> None:
    with pytest.raises(UsageError):
        parse_span(word, None, None)


def test_a_name_that_is_not_utf_8_is_a_name_like_any_other(cli: Cli) -> None:
    folder = os.fsdecode(b"\xfeout")
    write_ramp(cli.folder / f"{folder}.mp4", 3)
    formats = ("--format", "mkv", "--format", "mp4", "--format", "png16")
    cli("video", f"{folder}.mp4", "--out", f"{folder}/", *formats, code=0)
    assert len(here(cli)) == 1 + 2 + 3
    assert len(list(DepthVideo(cli.folder / folder / f"{folder}.depth.mkv").steps())) == 3


def test_stretched_frames_have_no_scale(inside: Cli) -> None:
    write_ramp(inside.folder / "clip.mp4", 3)
    words = ("video", "clip.mp4", "--png-normalize", "--sidecar", "--format", "png16")
    assert inside(*words).returncode == 0
    assert json.loads((inside.folder / "clip.depth.json").read_text())["scale"] is None
    inside(*words, "--format", "mkv", code=2)


def test_the_principal_point_is_stored_and_makes_the_same_points(inside: Cli) -> None:
    write_video(inside.folder / "clip.avi", flat_frames(range(2)))
    camera = ("--centre-px", "20.1,-3.25", "--hfov", "60", "--sidecar", "--json")
    options = (*camera, "--model", os.fspath(write_model(inside.folder / "m", camera=CAMERA)))
    done = inside("video", "clip.avi", "--out", "mkv/", "--format", "mkv", *options)
    assert [facts["centre_px"] for facts in printed(done)] == [[20.1, -3.25]]
    done = inside("video", "clip.avi", "--out", "npy/", "--format", "npy", *options, code=0)
    for sidecar in ("mkv/clip.depth.json", "npy/clip.depth.json"):
        assert json.loads((inside.folder / sidecar).read_text())["centre_px"] == [20.1, -3.25]
    for depth in DepthVideo(inside.folder / "mkv" / "clip.depth.mkv"):
        assert depth.provenance.centre_px == (20.1, -3.25)
    formats = ("--format", "png16", "--format", "exr")
    assert inside("video", "clip.avi", "--out", "files/", *formats, *options).returncode == 0
    for name in ("clip.depth.000001.png", "clip.depth.000001.exr"):
        assert read_metadata(inside.folder / "files" / name)["centre_px"] == "20.1,-3.25"
    sources = ("mkv/clip.depth.mkv", "--frame", "1"), ("files/clip.depth.000001.png",)
    for number, source in enumerate(sources):
        assert inside("convert", source[0], f"{number}.ply", *source[1:]).returncode == 0
    clouds = [(inside.folder / f"{number}.ply").read_bytes() for number in range(2)]
    assert clouds[0] == clouds[1]


def test_raw_frames_flow_through_a_pipe(inside: Cli) -> None:
    sent = np.stack(flat_frames(range(0, 250, 50)))
    height, width = sent.shape[1:3]
    encode(inside.folder / "in.mkv", sent, Fraction(30), "ffv1", "bgr0")
    raw = ("--raw", f"{width}x{height}:bgr24@30", "--json")
    piped = inside("video", "-", *raw, "-o", "raw.mkv", stdin=sent[..., ::-1].tobytes())
    assert (piped.returncode, printed(piped)[0]["fps"]) == (0, "30/1")
    assert inside("video", "in.mkv", "-o", "file.mkv").returncode == 0
    steps = [list(DepthVideo(inside.folder / name).steps()) for name in ("raw.mkv", "file.mkv")]
    np.testing.assert_array_equal(*steps)
    cut = inside("video", "-", *raw, "-o", "cut.mkv", stdin=sent[..., ::-1].tobytes()[:-9])
    assert (cut.returncode, printed(cut)[0]["frames"]) == (1, len(sent) - 1)
    for wrong, code in ("64x48:bogus@30", 1), ("64x48", 2), ("64x48:bgr24", 2), ("0x4:gray@1", 2):
        assert inside("video", "-", "--raw", wrong, "-o", "a.mkv", stdin=b"").returncode == code
    assert inside("video", "in.mkv", *raw).returncode == 2
