"""``depthcli video``, run from the built wheel as a user runs it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from tiny import write_model
from videos import NTSC, flat_frames, write_mp4, write_video

from depthcli.cli.arguments.span import parse_point, parse_span
from depthcli.core.choices import Detail
from depthcli.errors import UsageError
from depthcli.inference.pipeline import load
from depthcli.io.depth.facts import stated_facts
from depthcli.io.depth.read import read_depth
from depthcli.io.video.depth import DepthVideo
from depthcli.io.video.formats import SEQUENCES, VIDEO_FORMATS, VideoFormat
from depthcli.io.video.source import VideoSource
from depthcli.io.video.spans import Point, Span
from depthcli.jobs.video.plan import plan_video, video_formats

if TYPE_CHECKING:
    from pathlib import Path

    from command_line import Cli


def here(cli: Cli) -> set[str]:
    """Every file in the command's folder."""
    return {str(p.relative_to(cli.folder)) for p in cli.folder.rglob("*") if p.is_file()}


def ramp(cli: Cli, frames: int = 24) -> Path:
    """A clip at 30000/1001 whose frames get brighter, hence farther for the tiny model."""
    pictures = [
        np.repeat(np.linspace(i, 64 + 7 * i, 64).astype(np.uint8)[None, :, None], 48, 0).repeat(
            3, 2
        )
        for i in range(frames)
    ]
    return write_mp4(cli.folder / "clip.mp4", pictures)


def noisy(path: Path, scenes: int = 2, length: int = 25) -> Path:
    """Still scenes under noise, each of its own brightness."""
    rng = np.random.default_rng(0)
    columns = np.linspace(0, 60, 64)
    frames = [
        np.clip(columns[:, None] + 50 + 90 * scene + rng.normal(0, 9, (48, 64, 1)), 0, 255)
        .astype(np.uint8)
        .repeat(3, 2)
        for scene in range(scenes)
        for _ in range(length)
    ]
    return write_video(path, frames)


def times_ms(path: Path) -> list[float]:
    """When a video's frames are shown, as another program sees it."""
    capture, times = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), []
    while capture.grab():
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    return times


def report(done: subprocess.CompletedProcess[bytes]) -> dict[str, Any]:
    (line,) = done.stdout.decode().splitlines()
    found: dict[str, Any] = json.loads(line)
    return found


def test_without_options_lossless_depth_and_a_preview_beside_the_video(cli: Cli) -> None:
    ramp(cli)
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


def test_every_output_holds_the_same_millimetres(cli: Cli) -> None:
    ramp(cli)
    formats = [word for name in VideoFormat for word in ("--format", name)]
    done = cli("video", "clip.mp4", "--out", "out", "--json", *formats)
    assert (done.returncode, done.stderr) == (0, b"")
    facts = report(done)
    assert facts["outputs"] == [f"out/clip{VIDEO_FORMATS[name].suffix}" for name in VideoFormat]
    out = cli.folder / "out"
    for index, steps in enumerate(DepthVideo(out / "clip.depth.mkv").steps()):
        png = cv2.imread(str(out / f"clip.depth.{index:06d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(steps, png)
        for suffix in ("exr", "npy"):
            metres = read_depth(out / f"clip.depth.{index:06d}.{suffix}").values
            np.testing.assert_array_equal(steps, np.rint(metres * 1000))
    assert len(here(cli)) == 1 + len(set(VideoFormat) - set(SEQUENCES)) + 24 * len(SEQUENCES)


@pytest.mark.parametrize("name", ["mkv", "png16"])
def test_a_round_trip_keeps_rate_and_millimetres_frame_for_frame(cli: Cli, name: str) -> None:
    ramp(cli)
    done = cli("video", "clip.mp4", "--out", "out/", "--format", name, "--json")
    assert report(done)["fps"] == "30000/1001"
    with VideoSource(cli.folder / "clip.mp4") as source:
        frames = list(source.frames())
    if name == "mkv":
        video = DepthVideo(cli.folder / "out" / "clip.depth.mkv")
        assert video.rate == NTSC
        found = list(video)
    else:
        found = [read_depth(path) for path in sorted((cli.folder / "out").iterdir())]
    assert len(found) == len(frames) == 24
    pipeline = load(cli.models / "default", detail=Detail())
    for frame, depth in zip(frames, found, strict=True):
        expected = np.rint(pipeline.predict(frame).values * 1000)
        np.testing.assert_array_equal(np.rint(depth.values * 1000), expected)


def test_the_report_and_the_sidecar_state_the_exact_rate(cli: Cli) -> None:
    ramp(cli)
    done = cli("video", "clip.mp4", "--out", "d.mkv", "--sidecar", "--json", "--every", "2")
    facts = report(done)
    sidecar = json.loads((cli.folder / "d.json").read_text())
    for found in (facts, sidecar):
        assert (found["fps"], found["source_fps"]) == ("15000/1001", "30000/1001")
        assert (found["frames"], found["unit"], found["scale"]) == (12, "m", 1000)
        assert found["constant_rate"] is True
    assert facts["status"] == "ok"
    assert facts["outputs"] == ["d.mkv", "d.json"]
    assert here(cli) == {"clip.mp4", "d.mkv", "d.json"}


def test_frames_take_what_they_lack_from_their_video_s_sidecar(cli: Cli) -> None:
    ramp(cli, 2)
    write_model(cli.models / "default", camera={"hfov_deg": 90.0})
    words = ("--format", "png16", "--format", "npy", "--sidecar", "--focal-px", "60")
    assert cli("video", "clip.mp4", *words).returncode == 0
    path = cli.folder / "clip.depth.json"
    sidecar = json.loads(path.read_text())
    assert (len(sidecar["model_sha256"]), sidecar["focal_px"]) == (64, 60)
    assert sidecar["camera"].endswith("across (given)")
    # Version 0.1 called the checksum sha256; other models' sidecars say nothing of a frame.
    old = {"sha256" if name == "model_sha256" else name: v for name, v in sidecar.items()}
    other = sidecar | {"model_sha256": "0" * 64}
    for facts, orientation in ((sidecar, "1"), (old, "1"), (other, None)):
        path.write_text(json.dumps(facts))
        assert stated_facts(cli.folder / "clip.depth.000001.png").get("orientation") == orientation
    path.write_text(json.dumps(old))
    made_by = read_depth(cli.folder / "clip.depth.000001.npy").provenance
    assert made_by is not None
    assert (made_by.model_sha256, made_by.focal_px) == (sidecar["model_sha256"], 60)


def test_one_worker_and_several_write_the_same(cli: Cli) -> None:
    ramp(cli)
    for workers in ("1", "4"):
        options = ("--workers", workers, "--smooth", "0.1")
        assert cli("video", "clip.mp4", "--out", f"w{workers}/", *options).returncode == 0
    for name in ("clip.depth.mkv", "clip.preview.mp4"):
        one, four = ((cli.folder / f"w{n}" / name).read_bytes() for n in (1, 4))
        assert one == four


def test_start_end_and_every(cli: Cli) -> None:
    ramp(cli)
    whole = cli("video", "clip.mp4", "--out", "whole.mkv")
    assert whole.returncode == 0
    done = cli(
        *("video", "clip.mp4", "--out", "part/", "--format", "png16", "--format", "mkv"),
        *("--start", "0.2", "--end", "20f", "--every", "3", "--json"),
    )
    facts = report(done)
    indices = [6, 9, 12, 15, 18]
    assert (facts["frames"], facts["first_frame"], facts["fps"]) == (5, 6, "10000/1001")
    assert facts["start_s"] == pytest.approx(6 * 1001 / 30000)
    names = {f"part/clip.depth.{i:06d}.png" for i in indices}
    assert here(cli) == {"clip.mp4", "whole.mkv", "part/clip.depth.mkv"} | names
    steps = list(DepthVideo(cli.folder / "whole.mkv").steps())
    part = list(DepthVideo(cli.folder / "part" / "clip.depth.mkv").steps())
    np.testing.assert_array_equal(part, [steps[i] for i in indices])
    assert times_ms(cli.folder / "part" / "clip.depth.mkv") == pytest.approx(
        [round(i * 3 * 1001 / 30) for i in range(5)]  # the part begins at 0
    )


@pytest.mark.parametrize("every", ["25000", "25000s"])
def test_frames_can_be_hours_apart(cli: Cli, every: str) -> None:
    ramp(cli, 6)
    done = cli("video", "clip.mp4", "--out", "a/", "--every", every, "--json")
    assert done.returncode == 0, done.stderr
    rate = "6/5005" if every == "25000" else "1/25000"
    assert (report(done)["frames"], report(done)["fps"]) == (1, rate)
    assert str(DepthVideo(cli.folder / "a" / "clip.depth.mkv").rate) == rate


def test_smoothing_lowers_the_flicker_and_stops_at_a_cut(cli: Cli) -> None:
    noisy(cli.folder / "noise.avi")
    raw = cli("video", "noise.avi", "--out", "raw.mkv", "--json")
    smooth = cli("video", "noise.avi", "--out", "smooth.mkv", "--json", "--smooth", "0.3")
    before, after = report(raw), report(smooth)
    assert before["scenes"] == after["scenes"] == 2
    assert after["flicker_unsmoothed"] == pytest.approx(before["flicker"])
    assert after["flicker"] < before["flicker"] / 2
    first, second = (
        [depth.values for depth in DepthVideo(cli.folder / name)]
        for name in ("raw.mkv", "smooth.mkv")
    )
    # The first frame of the second scene, but for the rounding of a logarithm and back.
    np.testing.assert_allclose(first[25], second[25], atol=0.0011)
    assert np.median(second[24]) < np.median(first[25]) - 1
    noise = [
        np.std([values[20:28] for values in maps[10:25]], axis=0).mean() for maps in (first, second)
    ]
    assert noise[1] < noise[0] / 2


def colours(path: Path) -> list[np.ndarray[Any, Any]]:
    capture = cv2.VideoCapture(str(path))
    found = []
    while True:
        ok, pixels = capture.read()
        if not ok:
            return found
        found.append(pixels.astype(int))


def test_the_lock_holds_colours_and_lets_go_at_a_cut(cli: Cli) -> None:
    background = np.repeat(np.linspace(90, 160, 64).astype(np.uint8)[None, :], 48, 0)
    frames = []
    for i in range(30):
        picture = background.copy()
        picture[:6] = picture[:6] if i < 15 else 250  # something far comes into the picture
        frames.append(picture)
    frames += [np.full_like(background, 20)] * 3
    write_video(cli.folder / "a.avi", [np.repeat(f[..., None], 3, 2) for f in frames])
    for lock in ("0", "5"):
        options = ("--format", "mp4", "--lock", lock, "--colormap", "gray", "--near", "white")
        assert cli("video", "a.avi", "--out", f"{lock}.mp4", *options).returncode == 0
    free, held = (colours(cli.folder / f"{lock}.mp4") for lock in ("0", "5"))
    jump = [abs(f[16][40, 32] - f[13][40, 32]).max() for f in (free, held)]
    assert jump[0] > 40  # without it the change of one part repaints the rest
    assert jump[1] < 15
    assert abs(free[-1] - held[-1]).max() < 20


def test_a_preview_with_legend_and_picture(cli: Cli) -> None:
    ramp(cli, 5)
    options = ("--legend", "--side-by-side", "--vmin", "1", "--vmax", "9")
    assert cli("video", "clip.mp4", "--out", "a.mp4", *options).returncode == 0
    frame = colours(cli.folder / "a.mp4")[0]
    assert frame.shape[0] == 48
    assert frame.shape[1] > 2 * 64 + 30
    assert abs(frame[20:30, 2:62, 0] - frame[20:30, 2:62, 2]).mean() < 10  # the gray picture


def test_a_cut_video_is_written_as_far_as_it_goes(cli: Cli) -> None:
    path = write_video(cli.folder / "cut.avi", flat_frames(range(60)))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    done = cli("video", "cut.avi", "--out", "a.mkv", "--json")
    assert done.returncode == 1
    facts = report(done)
    assert facts["status"] == "incomplete"
    assert 5 < facts["frames"] < 60
    (line,) = done.stderr.decode().splitlines()
    assert f"ends after {facts['frames']} of 60 frames" in line
    assert len(list(DepthVideo(cli.folder / "a.mkv").steps())) == facts["frames"]


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "empty"), (b"no video at all" * 50, "no video"), (None, "no such file")],
)
def test_what_is_no_video_costs_one_line(cli: Cli, content: bytes | None, reason: str) -> None:
    if content is not None:
        (cli.folder / "a.mp4").write_bytes(content)
    before = here(cli)
    done = cli("video", "a.mp4", "--out", "out/", "--json")
    assert done.returncode == 1
    (line,) = done.stderr.decode().splitlines()
    assert reason in line
    assert report(done)["status"] == "failed"
    assert here(cli) == before


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--out", "clip.mp4"), "is the input"),
        (("--out", "a.gif"), ".mkv"),
        (("--out", "-"), "standard output"),
        (("--out", "a.mkv", "--format", "png16"), "folder"),
        (("--out", "a.mkv", "--format", "mp4"), ".mp4"),
        (("--format", "json"), "another --format"),
        (("--start", "soon"), "is not a time"),
        (("--start", "2", "--end", "1"), "the span is empty"),
        (("--every", "0"), "is not a step"),
        (("--smooth", "-1"), "0 or greater"),
        (("--focal-px", "500", "--hfov", "60"), "not both"),
        (("--format", "gif"), "gif"),
        (("--codec", "h264", "--format", "mkv"), "--codec is for mp4"),
        (("--codec", "h264", "--format", "webm"), "vp9 or av1"),
    ],
)
def test_wrong_usage(cli: Cli, options: tuple[str, ...], reason: str) -> None:
    (cli.folder / "clip.mp4").write_bytes(b"never read")
    done = cli("video", "clip.mp4", *options)
    assert done.returncode == 2
    (line,) = done.stderr.decode().splitlines()
    assert reason in line
    assert here(cli) == {"clip.mp4"}


def test_standard_input_is_refused(cli: Cli) -> None:
    done = cli("video", "-")
    assert done.returncode == 2
    assert b"save it to a file" in done.stderr


def test_a_link_to_the_input_is_not_replaced(cli: Cli) -> None:
    path = ramp(cli, 3)
    content = path.read_bytes()
    (cli.folder / "link.mp4").symlink_to("clip.mp4")
    assert cli("video", "clip.mp4", "--out", "link.mp4").returncode == 2
    assert path.read_bytes() == content


def test_a_span_beyond_the_end_is_one_line(cli: Cli) -> None:
    ramp(cli)
    done = cli("video", "clip.mp4", "--out", "a.mkv", "--start", "60")
    assert done.returncode == 1
    assert b"24 frames, 0.801 s" in done.stderr
    assert here(cli) == {"clip.mp4"}


def test_a_missing_model_is_a_failure_and_leaves_nothing(cli: Cli) -> None:
    ramp(cli, 3)
    done = cli("video", "clip.mp4", "--model", "nowhere.onnx")
    assert done.returncode == 3
    assert here(cli) == {"clip.mp4"}


def test_depth_without_a_unit_is_written_and_named_so(cli: Cli) -> None:
    write_model(
        cli.folder / "inverse", output__kind="inverse", output__min_m=None, output__max_m=None
    )
    ramp(cli, 6)
    done = cli("video", "clip.mp4", "--out", "a.mkv", "--model", "inverse", "--smooth", "0.2")
    assert done.returncode == 0
    assert b"no unit" in done.stderr
    assert DepthVideo(cli.folder / "a.mkv").scale is None


@pytest.mark.parametrize("formats", [("mkv", "mp4"), ("mkv", "webm")])
@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_nothing_is_left_of_an_interrupted_run(
    cli: Cli, formats: tuple[str, ...], which: signal.Signals
) -> None:
    write_video(cli.folder / "long.avi", flat_frames([50] * 20_000, 16, 16))
    options = [word for name in formats for word in ("--format", name)]
    running = subprocess.Popen(
        cli.command("video", "long.avi", "--out", "out/", *options),
        cwd=cli.folder,
        env=cli.environment,
        stderr=subprocess.DEVNULL,
    )
    until = time.monotonic() + 30
    while time.monotonic() < until and not list((cli.folder / "out").rglob("*")):
        time.sleep(0.02)
    time.sleep(0.2)
    running.send_signal(which)
    assert running.wait(timeout=30) == 128 + which
    assert here(cli) == {"long.avi"}
    assert list((cli.folder / "out").iterdir()) == []


@pytest.mark.parametrize("name", ["mkv", "mp4", "png16"])
def test_a_full_disk_is_an_error_and_leaves_nothing(cli: Cli, name: str) -> None:
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (64, 96, 3), dtype=np.uint8) for _ in range(60)]
    write_video(cli.folder / "noise.avi", pictures)
    limited = (
        "import resource, sys; from depthcli.cli.app import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (900, 900))\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    command = cli.command("video", "noise.avi", "--out", "out/", "--format", name)
    done = subprocess.run(
        [command[0], "-c", limited, *command[3:]],
        cwd=cli.folder,
        env=cli.environment,
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.decode().splitlines()) == 1
    assert here(cli) == {"noise.avi"}


def test_quiet_says_nothing(cli: Cli) -> None:
    ramp(cli, 3)
    done = cli("video", "clip.mp4", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_info_reads_a_depth_video(cli: Cli) -> None:
    ramp(cli, 5)
    cli("video", "clip.mp4", "--out", "a.mkv")
    facts = report(cli("info", "a.mkv", "--json"))
    assert (facts["frames"], facts["fps"], facts["unit"]) == (5, "30000/1001", "m")
    assert facts["valid"] == 5 * 48 * 64
    assert facts["metadata"]["scale"] == "1000"


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
    assert parse_point(word, "--start", bare_is_frames=bare) == point


@pytest.mark.parametrize("word", ["", "-1", "1e3", "1.5f", "1:2f", "a", "1:2:3:4", "nan", "٣"])
def test_what_is_no_place(word: str) -> None:
    with pytest.raises(UsageError):
        parse_point(word, "--start")


def test_no_span_is_the_whole_video() -> None:
    assert parse_span(None, None, None) == Span()


def test_names_of_outputs(tmp_path: Path) -> None:
    formats = (VideoFormat.MKV, VideoFormat.PNG16)
    assert plan_video("in/a.mov", None, formats).path(VideoFormat.MKV).as_posix() == (
        "in/a.depth.mkv"
    )
    assert plan_video("a.mov", "x/b.mkv", formats).names == {
        VideoFormat.MKV: "b.depth.mkv",
        VideoFormat.PNG16: "b.depth.%06d.png",
    }
    assert plan_video("a.mov", str(tmp_path), formats).folder == tmp_path
    assert video_formats("frames", ()) == (VideoFormat.MKV, VideoFormat.MP4)
    assert set(VIDEO_FORMATS) == set(VideoFormat)


def test_a_name_that_is_not_utf_8_is_a_name_like_any_other(cli: Cli) -> None:
    path = ramp(cli, 3)
    folder = os.fsdecode(b"\xfeout")
    path.rename(cli.folder / f"{folder}.mp4")
    formats = ("--format", "mkv", "--format", "mp4", "--format", "png16")
    done = cli("video", f"{folder}.mp4", "--out", f"{folder}/", *formats)
    assert done.returncode == 0, done.stderr
    assert len(here(cli)) == 1 + 2 + 3
    assert len(list(DepthVideo(cli.folder / folder / f"{folder}.depth.mkv").steps())) == 3


def test_frames_of_an_inverse_video_know_their_kind_from_its_sidecar(cli: Cli) -> None:
    write_model(
        cli.models / "default", output__kind="inverse", output__min_m=None, output__max_m=None
    )
    ramp(cli, 3)
    assert cli("video", "clip.mp4", "--format", "npy", "--sidecar").returncode == 0
    facts = json.loads(cli("info", "clip.depth.000002.npy", "--json").stdout)
    assert (facts["kind"], facts["unit"]) == ("inverse", None)


def test_stretched_frames_have_no_scale(cli: Cli) -> None:
    ramp(cli, 3)
    words = ("video", "clip.mp4", "--png-normalize", "--sidecar", "--format", "png16")
    assert cli(*words).returncode == 0
    assert json.loads((cli.folder / "clip.depth.json").read_text())["scale"] is None
    done = cli(*words, "--format", "mkv")
    assert done.returncode == 2
    assert b"mkv is in millimetres" in done.stderr


@pytest.mark.parametrize("name", ["clip.depth.mkv", "clip.preview.mp4"])
def test_a_folder_in_the_place_of_an_output_is_seen_at_once(cli: Cli, name: str) -> None:
    ramp(cli, 3)
    (cli.folder / name).mkdir()
    done = cli("video", "clip.mp4")
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1
    assert b"is a folder" in line
    assert here(cli) == {"clip.mp4"}
