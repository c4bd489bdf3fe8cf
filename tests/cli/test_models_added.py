"""``depthcli models add``, ``remove`` and ``cards``, and what such models' outputs are called."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers.tiny import tiny_onnx, write_model, write_picture

if TYPE_CHECKING:
    from helpers.command_line import Cli

FORMATS = ("png16", "exr", "npy", "preview", "json")


@pytest.fixture
def download(inside: Cli) -> Path:
    """An ONNX file as somebody downloads it."""
    file = inside.folder / "download.onnx"
    file.write_bytes(tiny_onnx(channels=3, size=(256, 256)))
    return file


def test_added_listed_shown_used_and_removed(inside: Cli, download: Path, picture: Path) -> None:
    added = inside("models", "add", download.name, "--card", "midas-small")
    assert added.returncode == 0
    assert added.stdout.startswith(b"midas-small: inverse depth, no unit, in ")
    assert b"\tinverse\t" in inside("models", "list").stdout
    shown = json.loads(inside("models", "show", "midas-small").stdout)
    assert (shown["file"], shown["bytes"]) == ("model.onnx", download.stat().st_size)
    assert inside("models", "verify", "midas-small").returncode == 0
    used = inside("predict", picture, "--model", "midas-small", "-o", "x.npy")
    assert used.returncode == 0
    assert inside("models", "remove", "midas-small", "nothing").returncode == 2
    assert inside("models", "show", "midas-small").returncode == 0
    removed = inside("models", "remove", "midas-small")
    assert removed.stdout.startswith(b"removed ")
    assert [p.name for p in inside.models.iterdir()] == ["default"]
    assert inside("predict", picture, "--model", "midas-small").returncode == 3


def test_a_taken_name_is_refused_without_force(inside: Cli, download: Path) -> None:
    add = ("models", "add", download, "--card", "midas-small", "--name", "mine")
    assert inside(*add, "--json").returncode == 0
    again = inside(*add)
    assert (again.returncode, again.stdout) == (2, b"")
    assert b"named 'mine' already exists" in again.stderr
    forced = inside(*add, "--force", "--json")
    told = json.loads(forced.stdout)
    assert (forced.returncode, told["name"]) == (0, "mine")
    assert Path(told["path"]) == inside.models / "mine"


def test_quiet_adds_without_a_word(inside: Cli, download: Path) -> None:
    done = inside("models", "add", download, "--card", "midas-small", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert (inside.models / "midas-small" / "card.json").is_file()


def test_a_bundled_model_is_hidden_with_force_and_comes_back(cli: Cli, download: Path) -> None:
    own = {"DEPTHCLI_MODELS": str(cli.folder / "own")}
    bundled = json.loads(cli("models", "show", "default", **own).stdout)
    add = ("models", "add", download, "--card", "midas-small", "--name", "default")
    refused = cli(*add, **own)
    assert (refused.returncode, refused.stdout) == (2, b"")
    assert b"_bundled" in refused.stderr
    assert b"--force" in refused.stderr
    assert cli(*add, "--force", **own).returncode == 0
    shown = json.loads(cli("models", "show", "default", **own).stdout)
    assert shown["bytes"] == download.stat().st_size
    assert cli("models", "remove", "default", **own).returncode == 0
    assert json.loads(cli("models", "show", "default", **own).stdout) == bundled
    kept = cli("models", "remove", "default", **own)
    assert kept.returncode == 2


@pytest.mark.parametrize(
    ("words", "code", "problem"),
    [
        (("download.onnx",), 2, "'depthcli models cards'"),
        (("download.onnx", "--card", "midas"), 2, "no ready card named 'midas'"),
        (("none.onnx", "--card", "midas-small"), 3, "No such file or directory; check its name"),
        (("download.onnx", "--card", "none.json"), 3, "cannot read none.json"),
        (("download.onnx", "--card", "midas-small", "--name", "../x"), 2, "name"),
    ],
)
def test_what_is_wrong_is_one_line(
    inside: Cli, download: Path, words: tuple[str, ...], code: int, problem: str
) -> None:
    assert download.is_file()
    done = inside("models", "add", *words)
    (line,) = done.stderr.decode().splitlines()
    assert done.returncode == code
    assert problem in line
    assert [p.name for p in inside.models.iterdir()] == ["default"]


def test_without_the_variable_models_lie_in_the_data_folder(inside: Cli, download: Path) -> None:
    places = {"DEPTHCLI_MODELS": "", "XDG_DATA_HOME": str(inside.folder / "data")}
    add = inside("models", "add", download, "--card", "midas-small", **places)
    assert add.returncode == 0
    assert (inside.folder / "data/depthcli/models/midas-small/card.json").is_file()
    listed = inside("models", "list", **places).stdout.decode()
    assert "midas-small\t" in listed
    assert "default\t" in listed


def test_the_ready_cards_ship_in_the_wheel(inside: Cli) -> None:
    cards = [json.loads(line) for line in inside("models", "cards", "--json").stdout.splitlines()]
    names = {card["name"] for card in cards}
    assert {"midas-small", "meter-nyu", "fastdepth", "depth-anything-v2-small"} <= names
    assert all(card["license"] and card["sources"] for card in cards)
    header, *rows = inside("models", "cards").stdout.decode().splitlines()
    assert header.split("\t")[0] == "card"
    assert len(rows) == len(cards)


def test_a_card_that_nobody_ran_with_real_weights_says_so(inside: Cli, download: Path) -> None:
    listed = inside("models", "cards")
    header, *rows = (line.split("\t") for line in listed.stdout.decode().splitlines())
    ran = {row[0]: row[header.index("run with real weights")] for row in rows}
    assert (ran["meter-nyu"], ran["midas-small"]) == ("yes", "no")
    assert b"depthcli eval nyu --data NYU --split val --limit 20 --model NAME" in listed.stderr
    added = inside("models", "add", download, "--card", "midas-small")
    (warning,) = added.stderr.decode().splitlines()
    assert "this card was never run with the real weights" in warning
    assert "eval nyu --data NYU --split val --limit 20 --model midas-small --align disp" in warning
    told = json.loads(
        inside("models", "add", download, "--card", "midas-small", "--force", "--json").stdout
    )
    assert told["preprocessing"]["run_with_weights"] is False
    assert "tf/run_onnx.py" in told["preprocessing"]["verified"]


def test_a_card_that_was_run_with_real_weights_is_no_warning(inside: Cli) -> None:
    file = inside.folder / "meter.onnx"
    file.write_bytes(tiny_onnx(channels=3, size=(256, 192)))
    added = inside("models", "add", file, "--card", "meter-nyu")
    assert (added.returncode, added.stderr) == (0, b"")


def test_a_ready_card_can_be_shown_and_used_as_a_file(inside: Cli, download: Path) -> None:
    (inside.folder / "mine.json").write_bytes(inside("models", "show", "midas-small").stdout)
    done = inside("models", "add", download, "--card", "mine.json", "--name", "mine")
    assert done.returncode == 0


def test_a_read_only_folder_is_one_line(inside: Cli, download: Path) -> None:
    inside.models.chmod(0o555)
    done = inside.as_user("models", "add", download, "--card", "midas-small")
    inside.models.chmod(0o755)
    assert done.returncode == 1
    assert b"cannot write" in done.stderr


@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_nothing_says_metres_of_what_has_none(inside: Cli, picture: Path, kind: str) -> None:
    changes = {"output__kind": kind, "output__min_m": None, "output__max_m": None}
    write_model(inside.models / "others", **changes)
    formats = [word for name in FORMATS for word in ("--format", name)]
    done = inside("predict", picture, "--model", "others", "-o", "out/", "--legend", *formats)
    said = done.stdout.decode()
    assert done.returncode == 0
    assert said.strip().endswith(f"({kind}, no unit)")
    assert " m\n" not in said
    for warning in ("png is normalized", "npy cannot say"):
        assert warning in done.stderr.decode()
    sidecar = json.loads((inside.folder / "out/room.depth.json").read_text())
    assert (sidecar["kind"], sidecar["unit"], sidecar["png16_scale"]) == (kind, None, None)
    for name in ("png", "exr", "npy"):
        file = f"out/room.depth.{name}"
        facts = json.loads(inside("info", file, "--json").stdout)
        assert (facts["kind"], facts["unit"]) == (kind, None)
        assert b"(no unit)" in inside("probe", file, "3,4").stdout
    told = inside("predict", picture, "--model", "others", "-o", "one.exr", "--json")
    assert json.loads(told.stdout)["unit"] is None


@pytest.mark.parametrize(("kind", "near_is_right"), [("relative", False), ("inverse", True)])
def test_near_is_warm_in_every_preview(inside: Cli, kind: str, near_is_right: bool) -> None:
    write_model(inside.models / "others", output__kind=kind, output__min_m=None)
    ramp = np.tile(np.linspace(0, 255, 64).astype(np.uint8), (48, 1))
    picture = write_picture(inside.folder / "ramp.png", ramp)
    done = inside("predict", picture, "--model", "others", "-o", "out/", "--format", "preview")
    assert done.returncode == 0
    preview = cv2.imread(str(inside.folder / "out/ramp.preview.png"))
    left, right = (int(preview[24, x].sum()) for x in (4, -4))  # inferno: warm is bright
    assert (right > left) is near_is_right


@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_anchors_give_metres(inside: Cli, kind: str) -> None:
    write_model(inside.models / "others", output__kind=kind, output__min_m=None)
    ramp = np.tile(np.linspace(0, 255, 64).astype(np.uint8), (48, 1))
    picture = write_picture(inside.folder / "ramp.png", ramp)
    far, near = (60, 4) if kind == "relative" else (4, 60)
    points = ("--anchor", f"{far},20,4.0", "--anchor", f"{near},20,1.6")
    done = inside("predict", picture, "--model", "others", "-o", "x.npy", *points, "--json")
    told = json.loads(done.stdout)
    depth = np.load(inside.folder / "x.npy")
    assert (told["kind"], told["unit"], told["warnings"]) == ("metric", "m", [])
    assert (depth[20, far], depth[20, near]) == pytest.approx((4, 1.6), rel=1e-4)
    middle = 0.5 * (4 + 1.6) if kind == "relative" else 2 / (1 / 4 + 1 / 1.6)
    assert depth[20, 32] == pytest.approx(middle, rel=0.02)
    swapped = ("--anchor", f"{far},20,1.6", "--anchor", f"{near},20,4.0")
    refused = inside("predict", picture, "--model", "others", "-o", "y.npy", *swapped)
    assert refused.returncode == 1
    assert b"contradict" in refused.stderr
    assert not (inside.folder / "y.npy").exists()


@pytest.mark.parametrize(
    "words", [("--provider", "cuda"), ("--provider", "cuda", "--provider-option", "device_id=1")]
)
def test_a_provider_that_is_not_there_is_exit_3(
    inside: Cli, picture: Path, words: tuple[str, ...]
) -> None:
    done = inside("predict", picture, *words)
    if done.returncode == 0:
        pytest.skip("this machine has CUDA")
    (line,) = done.stderr.decode().splitlines()
    assert done.returncode == 3
    assert "cuda" in line


def test_a_provider_that_nobody_knows_is_wrong_usage(inside: Cli, picture: Path) -> None:
    done = inside("predict", picture, "--provider", "gpu")
    (line,) = done.stderr.decode().splitlines()
    assert done.returncode == 2
    assert "no provider named 'gpu'; give one of auto, cuda" in line


@pytest.mark.parametrize("words", [("--provider-option", "a"), ("--provider-option", "a=1")])
def test_provider_options_without_a_provider_are_exit_2(
    inside: Cli, picture: Path, words: tuple[str, ...]
) -> None:
    done = inside("predict", picture, *words)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
