"""The examples of docs/extending.md, put where they say in a copy of the package, and used."""

import json
import re
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from helpers.command_line import finished
from helpers.rooms import large_rooms, rooms, write_rooms
from helpers.runs import EFFICIENT_TOML, ENVIRONMENT
from helpers.videos import flat_frames, write_mp4

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = re.compile(
    r"^```python\n# (\S+\.py)(, at the end)?\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
TINY = EFFICIENT_TOML.replace("epochs_decay = 2", "epochs_constant = 1\nepochs_decay = 0")


def place(example: re.Match[str], folder: Path) -> None:
    """A new file as it is; lines for a file that there is below the one that they begin with."""
    path, code = folder / example[1], example[3]
    if not path.exists():
        path.write_text(code, "utf-8")
        return
    old = path.read_text("utf-8")
    if example[2]:
        path.write_text(f"{old}\n\n{code}", "utf-8")
        return
    first, new = code.split("\n", maxsplit=1)
    assert old.count(f"{first}\n") == 1, f"{example[1]} has no line {first!r}"
    path.write_text(old.replace(f"{first}\n", f"{first}\n{new}"), "utf-8")


class Extended(NamedTuple):
    """A copy of the package with every example of the page in it."""

    folder: Path

    def run(self, *words: str, exit_code: int = 0) -> str:
        """What Python prints, in the folder of the copy."""
        environment = {**ENVIRONMENT, "PYTHONPATH": str(self.folder)}
        done = finished([sys.executable, *words], self.folder, env=environment)
        assert done.returncode == exit_code, done.stderr
        return done.stdout

    def train(self, method: str, data: str, *more: str) -> list[dict[str, float]]:
        """The losses of each epoch."""
        (self.folder / "tiny.toml").write_text(TINY)
        words = ("train", method, "--data", data, "--config", "tiny.toml", "--out", f"{data}-run")
        output = self.run("-m", "depthcli", *words, "--threads", "1", "--json", *more)
        return [json.loads(line)["losses"] for line in output.splitlines()]


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Extended:
    folder = tmp_path_factory.mktemp("extended")
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "depthcli", folder / "depthcli", ignore=ignored)
    (folder / "depthcli" / "_bundled").symlink_to(ROOT / "models")
    shutil.copy(ROOT / "docs" / "room.jpg", folder)
    for example in EXAMPLE.finditer((ROOT / "docs" / "extending.md").read_text("utf-8")):
        place(example, folder)
    return Extended(folder)


def test_an_output_format(extended: Extended) -> None:
    folder = extended.folder
    (folder / "in").mkdir()
    shutil.copy(folder / "room.jpg", folder / "in")
    write_mp4(folder / "in" / "clip.mp4", flat_frames([40, 200]))
    formats = ("--format", "asc", "--format", "npy")
    extended.run("-m", "depthcli", "predict", "room.jpg", "-o", "out/", *formats)
    extended.run("-m", "depthcli", "batch", "in", "--out", "all", *formats)
    extended.run("-m", "depthcli", "video", "in/clip.mp4", "--out", "one/", *formats)
    code = "import depthcli; depthcli.load_model().predict('room.jpg').save('out/api.depth.asc')"
    extended.run("-c", code)
    depth = np.load(folder / "out" / "room.depth.npy")
    for name in ("out/room.depth.asc", "out/api.depth.asc", "all/room.depth.asc"):
        written = np.loadtxt(folder / name, np.float32, skiprows=6)
        np.testing.assert_array_equal(written, depth)
    for place in ("all/clip", "one/clip"):
        for i in range(2):
            written = np.loadtxt(folder / f"{place}.depth.{i:06d}.asc", np.float32, skiprows=6)
            np.testing.assert_array_equal(written, np.load(folder / f"{place}.depth.{i:06d}.npy"))
    facts = json.loads(extended.run("-m", "depthcli", "info", "out/room.depth.asc", "--json"))
    assert (facts["width"], facts["max"]) == (640, pytest.approx(float(depth.max())))
    extended.run("-m", "depthcli", "convert", "out/room.depth.asc", "out/back.npy")
    np.testing.assert_array_equal(np.load(folder / "out" / "back.npy"), depth)


def test_an_output_format_never_replaces_a_foreign_file(extended: Extended) -> None:
    foreign = extended.folder / "scan.asc"
    extended.run("-m", "depthcli", "predict", "room.jpg", "-o", "scan.asc")
    foreign.write_bytes(b"ncols 1")
    words = ("predict", "room.jpg", "-o", "scan.asc")
    extended.run("-m", "depthcli", *words, exit_code=1)
    assert foreign.read_bytes() == b"ncols 1"
    code = "import depthcli; depthcli.load_model().predict('room.jpg').save('scan.asc', {})"
    extended.run("-c", code.format(""), exit_code=1)
    extended.run("-c", code.format("overwrite=True"))
    assert foreign.stat().st_size > 1_000_000
    for _ in range(2):  # its own is replaced
        extended.run("-m", "depthcli", "predict", "room.jpg", "-o", "again/", "--format", "asc")


def test_a_metric(extended: Extended) -> None:
    write_rooms(extended.folder / "nyu", large_rooms())
    words = ("eval", "nyu", "--data", "nyu", "--split", "val", "--no-model", "--csv", "table.csv")
    assert " near_1cm" in extended.run("-m", "depthcli", *words)
    header, *rows = (extended.folder / "table.csv").read_text().splitlines()
    assert header.split(",")[-1] == "near_1cm"
    assert all(0 <= float(row.split(",")[-1]) <= 1 for row in rows)


def test_a_loss(extended: Extended) -> None:
    write_rooms(extended.folder / "berhu")
    weights = ("--set", "loss.l1=0", "--set", "loss.berhu=10", "--preset", "bundled")
    (losses,) = extended.train("proposed", "berhu", *weights)
    assert set(losses) == {"berhu", "gradient"}
    assert losses["berhu"] > 0


def test_a_training_method(extended: Extended) -> None:
    write_rooms(extended.folder / "rooms")
    (losses,) = extended.train("direct", "rooms")
    assert set(losses) == {"l1"}
    assert " direct" in extended.run("-m", "depthcli", "train", "--help")


def test_transcript_of_a_method_and_a_loss_from_outside(extended: Extended) -> None:
    folder, page = extended.folder, (ROOT / "docs" / "extending.md").read_text("utf-8")
    section = page.partition("## From outside the package")[2].partition("\n## ")[0]
    for name in ("pairs", "test"):
        write_rooms(folder / name, prefix="a")  # other names than those of NYU
    (folder / "tiny.toml").write_text(TINY)
    commands = re.findall(r"^depthcli (.+)$", section, re.MULTILINE)
    assert [line.split()[0] for line in commands] == ["train", "export-onnx", *["eval"] * 3]
    output = ""
    for line in commands:
        words, _, file = line.partition(" >")
        settings = ["--config", "tiny.toml", "--threads", "1"] if "train" in words else []
        output = extended.run("-m", "depthcli", *words.split(), *settings)
        if file:
            (folder / file).write_text(output)
    assert "mine-model/ (mine) minus each row" in output
    (header,) = (line for line in output.splitlines() if line.startswith("minus"))
    assert header.split()[-1] == "within_5cm"
    (row,) = json.loads((folder / "mine.json").read_text())["rows"]
    values = [image["within_5cm"] for image in row["per_image"]]
    assert row["scores"]["within_5cm"] == pytest.approx(sum(values) / len(values))
    log = (folder / "runs" / "mine" / "metrics.jsonl").read_text().splitlines()
    (epoch,) = map(json.loads, log)
    assert set(epoch["losses"]) == {"mine:near_l1"}
    best = (folder / "runs" / "mine" / "best.txt").read_text()
    assert best == f"1 {epoch['scores']['abs_rel']:.4f}"


def test_a_data_set(extended: Extended) -> None:
    room_set, folder = rooms(), extended.folder / "desk"
    folder.mkdir()
    np.savez(folder / "scene.npz", images=room_set.images, depths_m=room_set.depths_m)
    assert extended.train("proposed", "desk", "--preset", "bundled")
    code = "from depthcli.lab.training.checkpoint import Checkpoint; from pathlib import Path; "
    code += "print(Checkpoint.load(Path('desk-run/last.ckpt')).provenance.hfov_deg)"
    assert float(extended.run("-c", code)) == 62.7
    assert "abs_rel" in extended.run("compare.py")
    output = extended.run("-m", "depthcli", "eval", "pairs", "desk", "--limit", "2")
    assert output.startswith(f"desk · all pairs, 2 of {len(room_set)} images")
