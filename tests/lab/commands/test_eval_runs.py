"""``depthcli eval runs`` on small runs that are really trained, exported and compared."""

import csv
import json
import math
import shutil
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.rooms import large_rooms, write_rooms
from helpers.tiny import load, write_image
from lightning_fabric import Fabric

from depthcli.cli.app import main
from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.types import Frame
from depthcli.errors import ExitCode
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.datasets.training_data import NYU_PAPER, TrainingData, open_training_data
from depthcli.lab.export.onnx import export_run, open_run
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.config import TrainConfig, updated
from depthcli.lab.training.methods.registry import default_config
from depthcli.lab.training.run import fit

SMALL = {
    "generator": {"width": 4, "blocks": 1},
    "data": {"width": 32, "height": 32, "holdout_every": 2, "holdout_offset": 1},
    "optim": {"epochs_constant": 2, "epochs_decay": 0, "width_discriminator": 2},
}
HELD_OUT = ["0002", "0005"]


def _config(method: str, seed: int = 0) -> TrainConfig:
    return replace(updated(default_config(method), SMALL), seed=seed)


def _train(config: TrainConfig, data: TrainingData, folder: Path, steps: float = math.inf) -> None:
    fit(config, data, folder, Fabric(accelerator="cpu", devices=1), Callback(), max_steps=steps)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rooms(tmp_path_factory.mktemp("set") / "nyu", large_rooms())


@pytest.fixture(scope="module")
def trained(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seeds of FastCUT, one run of the proposed method that stopped early."""
    folder = tmp_path_factory.mktemp("runs")
    dataset = TrainingData(open_nyu(data), NYU_PAPER, None)
    for seed in (0, 1):
        _train(_config("fastcut", seed), dataset, folder / f"fastcut-seed{seed}")
    _train(_config("proposed"), dataset, folder / "proposed-seed0", steps=5)
    return folder


@pytest.fixture
def runs(trained: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(trained, tmp_path / "runs"))


def _run(runs: Path, data: Path, *arguments: str) -> int:
    return main(["eval", "runs", str(runs), "--data", str(data), *arguments])


def _json(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    return json.loads(capsys.readouterr().out)


def _plainly(run: Path, data: Path, folder: Path) -> dict[str, float]:
    """Two of the metrics of a run, image by image and pixel by pixel."""
    dataset, model = open_nyu(data), export_run(open_run(run), folder)
    pipeline = load(model, detail=UpsamplingOptions(Upsampling.BILINEAR))
    abs_rel, d1 = [], []
    for i in (dataset.ids.index(name) for name in HELD_OUT):
        truth = dataset.depth_m(i).ravel().tolist()
        depth = pipeline.predict(Frame(dataset.image(i))).depth.values.ravel().tolist()
        pairs = [(g, min(max(p, 1e-3), 10.0)) for g, p in zip(truth, depth, strict=True)]
        pairs = [(g, p) for g, p in pairs if 1e-3 < g < 10]
        abs_rel.append(sum(abs(g - p) / g for g, p in pairs) / len(pairs))
        d1.append(sum(max(g / p, p / g) < 1.25 for g, p in pairs) / len(pairs))
    return {"abs_rel": sum(abs_rel) / len(abs_rel), "d1": sum(d1) / len(d1)}


def test_table_equals_a_plain_loop_over_seeds_and_held_out_images(
    trained: Path, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(trained, data, "--json") == 0
    document = _json(capsys)
    assert document["split"]["name"] == "val"
    assert document["split"]["images"] == len(HELD_OUT)
    rows = {row["name"]: row for row in document["rows"] if row["align"] in {"none", None}}
    assert [name for name in rows if "paper" not in name] == [
        *("constant mean", "per-pixel mean", "fastcut", "proposed")
    ]
    seeds = [_plainly(trained / f"fastcut-seed{k}", data, tmp_path) for k in (0, 1)]
    fastcut = rows["fastcut"]
    for metric in ("abs_rel", "d1"):
        values = [scores[metric] for scores in seeds]
        assert fastcut["scores"][metric] == pytest.approx(sum(values) / 2, abs=1e-6)
        spread = statistics.stdev(values)
        assert fastcut["standard_deviation"][metric] == pytest.approx(spread, abs=1e-6)
        each = [run["scores"][metric] for run in fastcut["runs"]]
        assert each == pytest.approx(values, abs=1e-6)
    alone = _plainly(trained / "proposed-seed0", data, tmp_path)
    assert rows["proposed"]["scores"]["abs_rel"] == pytest.approx(alone["abs_rel"], abs=1e-6)
    assert rows["proposed"]["standard_deviation"] is None


def test_text_csv_and_page_show_the_same_table(
    trained: Path, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, page, sheets = tmp_path / "t.csv", tmp_path / "t.html", tmp_path / "sheets"
    options = ("--csv", str(table), "--html", str(page), "--figures", str(sheets))
    assert _run(trained, data, *options, "--align", "none", "--align", "median") == 0
    out, html = capsys.readouterr().out, page.read_text()
    with table.open() as file:
        records = {(r["name"], r["align"]): r for r in csv.DictReader(file)}
    assert {("fastcut", "median"), ("CUT (paper)", "")} < records.keys()
    record = records["fastcut", "none"]
    cell = f"{float(record['abs_rel']):.4f}±{float(record['abs_rel_sd']):.4f}"
    assert cell in out
    assert cell in html
    assert html.count("data:image/png;base64,") == 2
    assert "http" not in html
    assert "<script" not in html
    assert sorted(p.name for p in sheets.iterdir()) == ["depth-colour.png", "depth-gray.png"]
    sheet = cv2.imread(str(sheets / "depth-colour.png"))
    assert sheet.shape[0] > 2 * 180
    assert sheet.shape[1] > 4 * 240  # input, two methods, truth, and the legend


def test_runs_on_pairs_of_ones_own_are_compared_on_their_scenes_that_were_held_out(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of sizes and cameras of their own, in the unit and up to the depth of the runs."""
    yard, numbers = tmp_path / "yard", np.random.default_rng(0)
    for scene in "abcd":
        size, depth_m = (48, 64) if scene < "c" else (36, 48), 20 + 8 * ord(scene) % 7
        for kind, values in (
            ("rgb", numbers.integers(0, 255, (*size, 3), np.uint8)),
            ("depth", numbers.integers(0, 256 * depth_m, size).astype(np.uint16)),
        ):
            write_image(yard / kind / scene / "0.png", values)
    (yard / "cameras.csv").write_text("id,focal_px\na/0,90\nb/0,50\nc/0,40\nd/0,40")
    settings = {"data": {"units_per_metre": 256.0}, "output": {"max_m": 30.0}}
    opened = open_training_data(yard, paired=True, units_per_metre=256)
    _train(updated(_config("proposed"), settings), opened, tmp_path / "runs" / "proposed-seed0")
    assert _run(tmp_path / "runs", yard) == ExitCode.USAGE  # no mean of pixels of two sizes
    assert "--no-trivial" in capsys.readouterr().err
    assert _run(tmp_path / "runs", data) == ExitCode.USAGE  # those of NYU
    assert "the data set that they were trained on" in capsys.readouterr().err
    assert _run(tmp_path / "runs", yard, "--no-trivial", "--json") == 0
    document = _json(capsys)
    ((row,), split) = document["rows"], document["split"]
    assert (document["dataset"], split["name"], split["images"]) == ("yard", "held-out", 2)
    assert "note" not in row
    words = ["eval", "pairs", str(yard), "--png-scale", "256", "--max-depth", "30", "--json"]
    (run,) = row["runs"]
    model = str(export_run(open_run(tmp_path / "runs" / run["name"]), tmp_path))
    assert main([*words, "--per-image", "--model", model]) == 0
    (every,) = _json(capsys)["rows"]
    held_out = [i["abs_rel"] for i in every["per_image"] if i["id"] in {"b/0", "d/0"}]
    assert run["scores"]["abs_rel"] == pytest.approx(sum(held_out) / 2, abs=1e-9)


def test_averaged_and_raw_weights_are_models_of_their_own(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = updated(_config("fastcut"), {"optim": {"ema": 0.9}})
    _train(
        config, TrainingData(open_nyu(data), NYU_PAPER, None), tmp_path / "runs" / "fastcut-seed0"
    )
    quiet = ("--json", "--no-trivial", "--no-published")
    documents = []
    for weights in ("averaged", "raw", "averaged"):
        assert _run(tmp_path / "runs", data, "--weights", weights, *quiet) == 0
        documents.append(_json(capsys))
    averaged, raw, again = (document["rows"][0] for document in documents)
    assert averaged["scores"] == again["scores"]
    assert averaged["scores"] != raw["scores"]
    has_note = [any("last step" in note for note in document["notes"]) for document in documents]
    assert has_note == [False, True, False]


def test_a_run_that_cannot_be_used_is_named_and_the_others_are_shown(
    runs: Path, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (runs / "proposed-seed0" / "last.ckpt").write_bytes(b"torn")
    assert _run(runs, data, "--no-trivial", "--no-published") == 1
    captured = capsys.readouterr()
    assert "fastcut" in captured.out
    assert captured.err.splitlines()[-1].startswith(
        "depthcli: error: 1 run is skipped: proposed-seed0 ("
    )
