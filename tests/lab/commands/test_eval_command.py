"""``depthcli eval nyu`` as a user types it, with a real model."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import write_image, write_model

from depthcli.cli.app import main
from depthcli.errors import ExitCode
from depthcli.lab.metrics.depth import METRICS

COUNT = 11


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eleven scenes of one pair: V of each image is what the tiny model takes for its depth."""
    root = tmp_path_factory.mktemp("nyu")
    lines = ["id,scene,official_split"]
    rows, columns = np.mgrid[0:480, 0:640].astype(np.float32)
    for i in range(COUNT):
        depth_m = 1.5 + i * 0.1 + 2.5 * rows / 480 + 1.5 * columns / 640
        value = np.round((depth_m - 1) / 8 * 255).astype(np.uint8)
        name = f"{i:04d}.png"
        write_image(root / "rgb" / name, np.dstack([value] * 3))
        write_image(root / "depth" / name, np.round(depth_m * 1000).astype(np.uint16))
        lines.append(f"{i:04d},room_{i:04d},{'test' if i % 2 else 'train'}")
    (root / "index.csv").write_text("\n".join(lines))
    return root


def _run(data: Path, *arguments: str) -> int:
    return main(["eval", "nyu", "--data", str(data), *arguments])


def _rows(capsys: pytest.CaptureFixture[str]) -> list[dict]:
    return json.loads(capsys.readouterr().out)["rows"]


@pytest.mark.usefixtures("models")
def test_default_model_is_scored(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run(data, "--split", "val", "--json") == ExitCode.OK
    rows = _rows(capsys)
    assert [row["source"] for row in rows] == ["trivial"] * 4 + ["model"]
    model = rows[-1]
    assert model["name"] == "tiny"
    assert model["images"] == 2
    assert len(model["model_sha256"]) == 64
    # Eight bits in the image are 31 mm; resizing to the network's 16×12 costs the rest.
    assert model["scores"]["abs_rel"] < 0.03
    assert model["scores"]["abs_rel"] < rows[2]["scores"]["abs_rel"] / 3


def test_row_of_a_model_trained_on_test_images_is_flagged(
    data: Path, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The official split tests on pairs 1, 3, 5, 7, 9."""
    write_model(models / "seen", training={"nyu_train_ids": "0003-0005,0008"})
    page, table = tmp_path / "page.html", tmp_path / "table.csv"
    arguments = ["--split", "official", "--no-trivial", "--model", "seen", "--model", "default"]
    assert _run(data, *arguments, "--html", str(page), "--csv", str(table)) == ExitCode.OK
    output = capsys.readouterr().out
    note = "seen was trained on 2 of these images"
    assert "\nseen* " in output
    assert f"\n* {note}" in output
    assert "\ndefault " in output
    assert note in page.read_text()
    with table.open() as file:
        assert [line["trained_on"] for line in csv.DictReader(file)] == ["2", ""]
    assert _run(data, *arguments, "--json") == ExitCode.OK
    flagged, default = _rows(capsys)
    assert flagged["images_trained_on"] == 2
    assert note in flagged["note"]
    assert "note" not in default


def test_models_are_compared_with_known_depth(
    data: Path, models: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a model whose metres are wrong; the points of an image are the same in every run."""
    far = write_model(models / "far", output__shift=9.0, output__max_m=20.0)
    arguments = ["--split", "val", "--no-trivial", "--model", str(far), "--json"]
    scores = []
    for extra in ([], ["uniform:200"], ["uniform:200"], ["lidar:4", "--anchors-fit", "global"]):
        assert _run(data, *arguments, *(["--prompt", *extra] if extra else [])) == ExitCode.OK
        report = json.loads(capsys.readouterr().out)
        scores.append(report["rows"][0]["scores"]["abs_rel"])
        assert any("uniform:200" in note for note in report["notes"]) == ("uniform:200" in extra)
    assert scores[0] > 0.5
    assert scores[1] == scores[2] < 0.03
    assert scores[3] < 0.05


@pytest.mark.usefixtures("models")
def test_edges_are_those_of_predict_and_metrics_of_depth_completion_are_columns(
    data: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bilinear upsampling, the default without edges, leaves none."""
    monkeypatch.setattr("depthcli.lab.metrics.depth.METRICS", dict(METRICS))
    arguments = ["--split", "val", "--no-trivial", "--json"]
    for extra, upsampling in (
        (["--boundary"], "guided"),
        (["--boundary", "--upsample", "bilinear"], "bilinear"),
        (["--images", "1", "--crop", "s2d", "--metric", "mae", "--metric", "d105"], "bilinear"),
    ):
        assert _run(data, *arguments, *extra) == ExitCode.OK
        report = json.loads(capsys.readouterr().out)
        assert report["protocol"]["upsampling"] == upsampling
    (row,) = report["rows"]
    assert (row["images"], row["pixels"]) == (1, 304 * 228)
    assert 0 < row["scores"]["mae"] < 0.1
    assert row["scores"]["d105"] > 0.9


@pytest.mark.parametrize(
    "arguments",
    [
        ["--no-model"],  # the paper's split has none of these pairs
        ["--model", "default", "--no-model"],
        ["--no-model", "--per-image"],
        ["--split", "val", "--no-model", "--no-trivial"],
        ["--split", "val", "--predictions", ".", "--predictions-kind", "feet"],
        ["--split", "val", "--predictions", ".", "--predictions-kind", "disparity"],
        ["--split", "test"],
        ["--split", "val", "--no-model", "--against", "CUT (paper)"],
        ["--split=val", "--no-model", "--average=pooled", "--against=constant mean"],
        ["--limit", "0"],
        ["--split", "val", "--prompt", "everywhere"],
        ["--split", "val", "--anchors-fit", "local"],
        ["--split", "val", "--predictions", ".", "--prompt", "lidar:4"],
    ],
)
def test_usage_errors_are_one_line(
    arguments: list[str], data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(data, *arguments) == ExitCode.USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert "{" not in line
