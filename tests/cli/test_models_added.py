"""``depthcli models add``, ``remove`` and ``cards``, and what such models' outputs are called."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.tiny import tiny_onnx, write_model, write_picture


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


def test_a_ready_card_can_be_shown_and_used_as_a_file(inside: Cli, download: Path) -> None:
    (inside.folder / "mine.json").write_bytes(inside("models", "show", "midas-small").stdout)
    done = inside("models", "add", download, "--card", "mine.json", "--name", "mine")
    assert done.returncode == 0


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
