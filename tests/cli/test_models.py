"""The commands about models: listing, adding, checking."""

import hashlib
import json
import os
from pathlib import Path

import numpy as np
import onnx
import pytest
from helpers.command_line import ROOT, Cli
from helpers.tiny import tiny_onnx, write_image, write_model


def spoil(cli: Cli, name: str) -> None:
    path = write_model(cli.models / name) / "model.onnx"
    path.write_bytes(path.read_bytes()[:-1] + b"\0\0")


def test_the_list_shows_what_is_there(inside: Cli) -> None:
    write_model(inside.models / "other", version="7.7")
    plain, runs = inside("models"), inside("models", "list")
    assert plain.returncode == runs.returncode == 0
    assert plain.stdout == runs.stdout
    header, *rows = (line.split("\t") for line in runs.stdout.decode().splitlines())
    assert header[:3] == ["name", "version", "kind"]
    assert ["other", "7.7", "metric"] in [row[:3] for row in rows]
    assert "default" in [row[0] for row in rows]


def test_the_bundled_models_are_in_the_wheel_and_run(cli: Cli) -> None:
    nothing_else = {"DEPTHCLI_MODELS": ""}
    listed = cli("models", "list", "--json", **nothing_else).stdout.splitlines()
    models = {row["name"]: row for row in map(json.loads, listed)}
    assert models.keys() == {"default", "error", "fast", "float", "prompted", "sharp"}
    write_image(cli.folder / "a.png")
    words = ("predict", "a.png", "-o", "a.npy", "--json", "--model", "fast")
    facts = json.loads(cli(*words, **nothing_else).stdout)
    assert (facts["status"], facts["model"]) == ("ok", "fast")
    data = (ROOT / "models" / "fast" / "model.onnx").read_bytes()
    assert facts["model_sha256"] == models["fast"]["sha256"] == hashlib.sha256(data).hexdigest()


def test_the_list_for_machines(inside: Cli) -> None:
    spoil(inside, "broken")
    done = inside("models", "list", "--json", code=3)
    models = {m["name"]: m for m in map(json.loads, done.stdout.splitlines())}
    assert models["default"]["status"] == "ok"
    assert models["broken"]["status"] == "failed"
    assert "bytes" in models["broken"]["error"]


def test_show_prints_the_card(inside: Cli) -> None:
    card = json.loads(inside("models", "show", code=0).stdout)
    assert card == json.loads((inside.models / "default" / "card.json").read_text()) | {
        "training": {},
        "scores": {},
        "latency": {},
    }


def test_verify_goes_on_after_a_broken_one(inside: Cli) -> None:
    spoil(inside, "broken")
    plain = inside("models", "verify", "broken", "default", code=3)
    assert plain.stdout.startswith(b"default: ok")
    assert plain.stderr.count(b"\n") == 1
    done = inside("models", "verify", "--json", "broken", "default")
    failed, fine = map(json.loads, done.stdout.splitlines())
    assert (failed["name"], failed["status"]) == ("broken", "failed")
    assert (fine["name"], fine["status"]) == ("default", "ok")
    assert len(fine["sha256"]) == 64


@pytest.fixture
def download(inside: Cli) -> Path:
    """An ONNX file as somebody downloads it."""
    file = inside.folder / "download.onnx"
    file.write_bytes(tiny_onnx(channels=3, size=(256, 256)))
    return file


def test_added_listed_shown_used_and_removed(inside: Cli, download: Path, image: Path) -> None:
    added = inside("models", "add", download.name, "--card", "midas-small", code=0)
    assert added.stdout.startswith(b"midas-small: inverse depth, no unit, in ")
    assert b"\tinverse\t" in inside("models", "list").stdout
    card = json.loads(inside("models", "show", "midas-small").stdout)
    assert (card["file"], card["bytes"]) == ("model.onnx", download.stat().st_size)
    assert inside("models", "verify", "midas-small").returncode == 0
    inside("predict", image, "--model", "midas-small", "-o", "x.npy", code=0)
    assert inside("models", "remove", "midas-small", "nothing").returncode == 2
    assert inside("models", "show", "midas-small").returncode == 0
    removed = inside("models", "remove", "midas-small")
    assert removed.stdout.startswith(b"removed ")
    assert [p.name for p in inside.models.iterdir()] == ["default"]
    assert inside("predict", image, "--model", "midas-small").returncode == 3


def test_a_bundled_model_is_hidden_with_force_and_comes_back(inside: Cli, download: Path) -> None:
    env = {"DEPTHCLI_MODELS": str(inside.folder / "own")}
    bundled = json.loads(inside("models", "show", "default", **env).stdout)
    add = ("models", "add", download, "--card", "midas-small", "--name", "default")
    refused = inside(*add, **env)
    assert (refused.returncode, refused.stdout) == (2, b"")
    assert b"--force" in refused.stderr
    assert inside(*add, "--force", **env).returncode == 0
    card = json.loads(inside("models", "show", "default", **env).stdout)
    assert card["bytes"] == download.stat().st_size
    assert inside("models", "remove", "default", **env).returncode == 0
    assert json.loads(inside("models", "show", "default", **env).stdout) == bundled
    inside("models", "remove", "default", **env, code=2)


def test_without_the_variable_models_lie_in_the_data_folder(inside: Cli, download: Path) -> None:
    places = {"DEPTHCLI_MODELS": "", "XDG_DATA_HOME": str(inside.folder / "data")}
    inside("models", "add", download, "--card", "midas-small", **places, code=0)
    assert (inside.folder / "data/depthcli/models/midas-small/card.json").is_file()
    listed = inside("models", "list", **places).stdout.decode()
    assert "midas-small\t" in listed
    assert "default\t" in listed


def test_without_home_and_account_nothing_is_kept(
    inside: Cli, download: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(os, "getuid", lambda: 2**31 - 9)  # as of a user in a container
    places = {"DEPTHCLI_MODELS": "", "XDG_DATA_HOME": ""}
    inside("models", "list", **places, code=0)
    refused = inside("models", "add", download, "--card", "midas-small", **places)
    assert (refused.returncode, refused.stderr.count(b"\n")) == (1, 1)
    assert not (inside.folder / "~").exists()


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
    inside("models", "add", download, "--card", "mine.json", "--name", "mine", code=0)


QUICK = ("--seconds", "0.05", "--provider", "cpu")


def test_measures_add_up(inside: Cli) -> None:
    size = ("--size", "1200x900", "--workers", "2", "--threads", "3")
    done = inside("bench", *QUICK, *size, "--json", code=0)
    facts = json.loads(done.stdout)
    for latency in (facts["network"], facts["end_to_end"]):
        assert 0 < latency["min_ms"] <= latency["median_ms"]
        assert latency["noise"] >= 0
        assert latency["runs"] >= 5
    assert facts["images_per_s"] > 0
    assert facts["peak_memory_mb"] > 30
    assert (facts["workers"], facts["threads"], facts["provider"]) == (2, 3, "cpu")
    assert len(facts["model_sha256"]) == 64


def test_an_image_of_ones_own(inside: Cli, image: Path) -> None:
    done = inside("bench", *QUICK, image, code=0)
    lines = done.stdout.decode().splitlines()
    assert [line.split("  ")[0] for line in lines[1:]] == [
        *("network", "end-to-end", "throughput", "peak memory")
    ]


def checks(stdout: bytes) -> dict[str, dict[str, str]]:
    return {check["name"]: check for check in map(json.loads, stdout.splitlines())}


def test_all_is_well(cli: Cli) -> None:
    findings = checks(cli("doctor", "--json", "--provider", "cpu", code=0).stdout)
    assert findings["model"]["status"] == "ok"
    assert "runs on cpu" in findings["model"]["detail"]
    assert findings["codec .png"]["status"] == findings["import OpenEXR"]["status"] == "ok"
    assert findings["numpy"]["detail"]


@pytest.mark.parametrize(
    ("module", "package", "code"),
    [
        ("cv2", "opencv-python-headless", "raise ImportError('libGL.so.1: cannot open\\nit')"),
        ("onnxruntime", "onnxruntime", ""),
        ("onnxruntime", "onnxruntime", "raise RuntimeError('built for another NumPy')"),
    ],
)
def test_a_broken_package_is_a_finding(cli: Cli, module: str, package: str, code: str) -> None:
    broken = cli.folder / "broken" / module
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text(code)
    done = cli("doctor", "--json", PYTHONPATH=f"{broken.parent}:{cli.site}")
    findings = checks(done.stdout)
    assert (done.returncode, done.stderr) == (3, b"")
    assert findings[f"import {module}"]["status"] == "failed"
    assert f"pip install --force-reinstall {package}" in findings[f"import {module}"]["detail"]
    assert all("\n" not in check["detail"] for check in findings.values())
    assert findings["import numpy"]["status"] == findings["import OpenEXR"]["status"] == "ok"
    other = "codec .png" if module == "onnxruntime" else "import onnxruntime"
    assert findings[other]["status"] == "ok"


@pytest.mark.parametrize(("channels", "size"), [(3, None), (1, (24, 32))])
def test_a_new_card_makes_a_network_run(
    channels: int, size: tuple[int, int] | None, inside: Cli
) -> None:
    (inside.folder / "my net.onnx").write_bytes(tiny_onnx(channels=channels, size=size))
    write_image(inside.folder / "a.png")
    words = ("predict", "a.png", "-o", "a.npy", "--model", "./my net.onnx")
    assert b"depthcli models new-card 'my net.onnx'" in inside(*words).stderr
    done = inside("models", "new-card", "my net.onnx")
    card = json.loads((inside.folder / "my net.card.json").read_text())
    spec = card["input"]
    assert (spec["dynamic"], spec["colour"]) == (size is None, "rgb" if channels == 3 else "luma")
    assert (spec["height"], spec["width"]) == (size or (518, 518))
    for guess in ("output.kind is inverse", "input.mean is 0.", "license is"):
        assert guess.encode() in done.stderr
    assert inside(*words).returncode == 0
    added = inside("models", "add", "my net.onnx", "--card", "my net.card.json", "--name", "mine")
    assert (added.returncode, inside(*words[:-1], "mine", "--overwrite").returncode) == (0, 0)


def test_a_new_card_has_what_is_stated_and_replaces_no_file(inside: Cli) -> None:
    (inside.folder / "a.onnx").write_bytes(tiny_onnx(channels=3))
    words = ("models", "new-card", "a.onnx", "-o", "b.json", "--kind", "metric")
    done = inside(*words, "--mean", "0", "--std", "1,2,3", "--colour", "rgb")
    card = json.loads((inside.folder / "b.json").read_text())
    assert (card["output"]["kind"], card["input"]["mean"]) == ("metric", [0])
    assert card["input"]["std"] == [1, 2, 3]
    assert b"input.mean" not in done.stderr
    assert b"camera is null" in done.stderr
    assert inside(*words).returncode == 1
    assert inside(*words, "--overwrite", "--mean", "1,2").returncode == 2


def test_a_network_may_give_a_map_without_axes_of_images(inside: Cli) -> None:
    model = onnx.load_from_string(tiny_onnx())
    model.graph.node[0].output[0] = "deep"
    model.graph.node.append(onnx.helper.make_node("Squeeze", ["deep"], ["depth"]))  # (h, w)
    onnx.save(model, inside.folder / "flat.onnx")
    write_image(inside.folder / "a.png")
    inside("models", "new-card", "flat.onnx", "--mean", "0", "--std", "1", "--colour", "value")
    words = ("predict", "a.png", "--model", "./flat.onnx", "-o")
    assert inside(*words, "flat.npy").returncode == 0
    assert np.load(inside.folder / "flat.npy").shape == (48, 64)
