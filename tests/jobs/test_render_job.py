"""A folder of rendered rooms: the same bytes however it came to be, as training reads it."""

import json
import signal
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.file_trees import contents
from helpers.watched import Watched

from depthcli.cli.shell import run
from depthcli.core.camera import Intrinsics
from depthcli.core.types import Frame
from depthcli.datasets.folders import open_paired_folder
from depthcli.datasets.rooms.render import VERSION, RoomSettings, render_pair, room_focal_px
from depthcli.datasets.training_data import open_training_data
from depthcli.errors import DatasetError, UsageError
from depthcli.inference.camera import intrinsics_of, metric_scale
from depthcli.inference.transforms import input_layout
from depthcli.jobs.render import render
from depthcli.models.catalog import find_model

ROOT = Path(__file__).parents[2]
SETTINGS = RoomSettings(seed=4, size=(32, 24))
COUNT = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rendered") / "rooms"
    render(out, COUNT, SETTINGS)
    return out


def test_workers_count_and_interruptions_change_no_byte(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    assert render(out, 1, SETTINGS) == 1
    assert render(out, COUNT, SETTINGS, workers=2) == COUNT - 1
    (out / "depth/0000/000002.png").unlink()
    (out / "rgb/0000/000001.jpg").unlink()
    assert render(out, COUNT, SETTINGS) == 2
    assert render(out, 2, SETTINGS) == 0
    assert contents(out) == contents(folder)


def test_a_signal_ends_the_workers_too(cli: Cli) -> None:
    words = ("render", "rooms", "--out", "r", "--count", "500", "--size", "32x24", "--workers", "2")
    process = cli.started(*words)
    until = time.monotonic() + 60
    while time.monotonic() < until and not list(cli.folder.glob("r/depth/*/*.png")):
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=20)  # until the last of them has closed it
    assert (process.returncode, said) == (128 + signal.SIGTERM, b"")


def test_a_folder_holds_a_hundred_rooms_and_missing_ones_are_told(tmp_path: Path) -> None:
    for number in range(100):
        for path in (f"rgb/0000/{number:06}.jpg", f"depth/0000/{number:06}.png"):
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).touch()
    watched = Watched()
    (tmp_path / "rooms.json").write_text(json.dumps({"version": VERSION, **SETTINGS._asdict()}))
    rendered = render(tmp_path, 102, SETTINGS, progress=watched)
    assert (rendered, watched.begun, watched.counts) == (2, [("", 2, "rooms")], [[1, 1]])
    assert {path.stem for path in tmp_path.glob("*/0001/*")} == {"000100", "000101"}


def test_files_contain_the_rendered_pair(folder: Path) -> None:
    pair, pairs = render_pair(SETTINGS, 3), open_paired_folder(folder)
    assert pairs.ids == tuple(f"0000/{i:06}" for i in range(COUNT))
    np.testing.assert_allclose(pairs.depth_m(3), pair.depth_m, atol=0.00051)
    assert np.abs(pairs.image(3).astype(int) - pair.rgb).mean() < 6
    assert pairs.focal_px == pytest.approx([room_focal_px(SETTINGS, i) for i in range(COUNT)])


def test_rooms_of_other_options_do_not_mix(folder: Path) -> None:
    before = contents(folder)
    with pytest.raises(UsageError):
        render(folder, COUNT, SETTINGS._replace(seed=5))
    assert contents(folder) == before


@pytest.mark.parametrize("held", [b'{"version": 0}', b"\xff"])
def test_rooms_of_another_version_are_not_mixed(tmp_path: Path, held: bytes) -> None:
    (tmp_path / "rooms.json").write_bytes(held)
    with pytest.raises(UsageError):
        render(tmp_path, 1, SETTINGS)


def test_other_pictures_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "rgb").mkdir()
    with pytest.raises(UsageError):
        render(tmp_path, 1, SETTINGS)


def test_a_model_that_learns_the_rooms_gives_their_metres(folder: Path) -> None:
    """What it is taught, multiplied as its predictions are, is the depth that was rendered."""
    card = find_model(ROOT / "models/default").card
    data = open_training_data(folder, paired=True)
    truth = open_paired_folder(folder)
    assert data.hfov_deg == card.camera.hfov_deg
    place = input_layout(card.input, *SETTINGS.size)
    for i in range(COUNT):
        frame = Frame(truth.image(i))
        camera = intrinsics_of(card, frame, Intrinsics(truth.focal_px[i]))
        scale = metric_scale(card, frame, place, camera)
        there = truth.depth_m(i)
        np.testing.assert_allclose(data.dataset.depth_m(i) * scale, there, rtol=2e-3)
    extra = open_training_data(folder, paired=True).with_pseudo_labels(truth).pseudo_labels
    np.testing.assert_array_equal(extra.depth_m(1), data.dataset.depth_m(1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,focal_px\na,30\n", "has no focal_px of 'b'"),
        ("id,mm\na,30\nb,30\n", "has no columns id,focal_px"),
        ("id,hfov_deg\na,30\nb,30\n", "has no focal_px of 'a'"),
        ("id,focal_px\na,30\nb,long\n", "line 3: focal_px is a number .*, not 'long'"),
        ("id,focal_px\na,30\nb,nan\n", "focal_px is a number from 0.001 to 1e8"),
        ("id,focal_px\na,30\nb,1e300\n", "focal_px is a number from 0.001 to 1e8"),
    ],
)
def test_incomplete_cameras_csv_is_refused(tmp_path: Path, text: str, message: str) -> None:
    for kind, pixels in (("rgb", np.zeros((4, 4, 3), np.uint8)), ("depth", np.uint16([[2000]]))):
        (tmp_path / kind).mkdir()
        for name in "ab":
            cv2.imwrite(
                str(tmp_path / kind / f"{name}.png"),
                np.broadcast_to(pixels, (4, 4, *pixels.shape[2:])).copy(),
            )
    assert open_paired_folder(tmp_path).focal_px == ()
    (tmp_path / "cameras.csv").write_text("\ufeffid,focal_px\na,30\nb,40\n")  # as Excel writes it
    assert open_paired_folder(tmp_path).focal_px == (30, 40)
    (tmp_path / "cameras.csv").write_text(text)
    with pytest.raises(DatasetError, match=message):
        open_paired_folder(tmp_path)


def test_render_command_reports_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["render", "rooms", "--out", str(tmp_path / "r"), "--count", "1", "--size", "24x16"]
    words += ["--hfov", "63.3", "--sensor", "kinect", "--seed", "2", "--workers", "1"]
    assert run([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"out": str(tmp_path / "r"), "rooms": 1, "rendered": 1}
    assert run(words) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'r'}: 1 rooms, 0 rendered now\n"
    assert run([*words, "--quiet"]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    "words",
    [
        ("--hfov", "80-40"),
        ("--hfov", "wide"),
        ("--hfov", "0-50"),
        ("--hfov", "nan"),
        ("--size", "9"),
        ("--count", "0"),
    ],
)
def test_options_that_mean_nothing_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, str]
) -> None:
    assert run(["render", "rooms", "--out", str(tmp_path / "r"), *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "r").exists()
