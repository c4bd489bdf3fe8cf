"""``depthcli eval nyu`` as a user types it, with a real model."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import pty
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers.tiny import write_model

from depthcli.cli.app import main
from depthcli.datasets.base import SplitName, split_nyu
from depthcli.datasets.nyu import open_nyu
from depthcli.errors import ExitCode

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

COUNT = 11


def _depth_m(i: int) -> npt.NDArray[np.float32]:
    rows, columns = np.mgrid[0:480, 0:640].astype(np.float32)
    return 1.5 + i * 0.1 + 2.5 * rows / 480 + 1.5 * columns / 640


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eleven scenes of one pair: V of each picture is what the tiny model takes for its depth."""
    root = tmp_path_factory.mktemp("nyu")
    (root / "rgb").mkdir()
    (root / "depth").mkdir()
    lines = ["id,scene,official_split"]
    for i in range(COUNT):
        depth_m = _depth_m(i)
        value = np.round((depth_m - 1) / 8 * 255).astype(np.uint8)
        name = f"{i:04d}.png"
        cv2.imwrite(str(root / "rgb" / name), np.dstack([value] * 3))
        cv2.imwrite(str(root / "depth" / name), np.round(depth_m * 1000).astype(np.uint16))
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
    # Eight bits in the picture are 31 mm; resizing to the network's 16×12 costs the rest.
    assert model["scores"]["abs_rel"] < 0.03
    assert model["scores"]["abs_rel"] < rows[2]["scores"]["abs_rel"] / 3


def test_a_model_that_learned_the_pictures_is_flagged(
    data: Path, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The official split tests on pairs 1, 3, 5, 7, 9."""
    write_model(models / "seen", training={"nyu_train_ids": "0003-0005,0008"})
    page, table = tmp_path / "page.html", tmp_path / "table.csv"
    arguments = ["--split", "official", "--no-trivial", "--model", "seen", "--model", "default"]
    assert _run(data, *arguments, "--html", str(page), "--csv", str(table)) == ExitCode.OK
    shown = capsys.readouterr().out
    note = "seen was trained on 2 of these images"
    assert "\nseen* " in shown
    assert f"\n* {note}" in shown
    assert "\ndefault " in shown
    assert note in page.read_text()
    with table.open() as file:
        assert [line["trained_on"] for line in csv.DictReader(file)] == ["2", ""]
    assert _run(data, *arguments, "--json") == ExitCode.OK
    seen, default = _rows(capsys)
    assert seen["images_trained_on"] == 2
    assert note in seen["note"]
    assert "note" not in default


@pytest.mark.usefixtures("models")
def test_table_names_protocol_split_and_images(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(data, "--split", "val") == ExitCode.OK
    output = capsys.readouterr()
    lines = output.out.splitlines()
    assert lines[0] == "NYU Depth v2 · val split, 2 of 134 images · protocol: headline"
    assert lines[3].split()[:4] == ["row", "align", "images", "abs_rel"]
    assert {len(line) for line in lines[3:9]} == {len(lines[3])}
    assert "comparing images: 2" in output.err
    note = "not all of pairs 1-1000 are here, so the held-out scenes are not those of all of them"
    assert note in lines


def test_several_models_and_files(
    data: Path, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = write_model(models / "far", output__shift=6.0)
    files = tmp_path / "files"
    files.mkdir()
    for i in range(COUNT):
        np.save(files / f"{i:04d}.npy", _depth_m(i))
    arguments = ["--model", "default", "--model", str(far), "--predictions", str(files)]
    assert _run(data, "--split", "val", "--no-trivial", "--json", *arguments) == ExitCode.OK
    near, farther, exact = _rows(capsys)
    assert [row["name"] for row in (near, farther, exact)] == ["default", str(far), str(files)]
    assert near["scores"]["rmse"] < farther["scores"]["rmse"]
    assert exact["scores"]["rmse"] < 0.001
    assert exact["source"] == "files"


def test_a_row_is_compared_with_every_other(
    data: Path, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far, page = write_model(models / "far", output__shift=6.0), tmp_path / "page.html"
    arguments = ["--split", "val", "--model", "default", "--model", str(far), "--against", str(far)]
    assert _run(data, *arguments, "--json", "--per-image") == ExitCode.OK
    document = json.loads(capsys.readouterr().out)
    rows = {(row["name"], row["align"]): row for row in document["rows"]}
    others = ["constant mean", "per-pixel mean", "default"]
    assert [entry["minus"] for entry in document["differences"]] == others
    for entry in document["differences"]:
        assert (entry["row"], entry["align"]) == (str(far), "none")
        for metric in ("abs_rel", "d1", "silog"):
            interval = entry["intervals"][metric]
            own, other = (
                [image[metric] for image in rows[name, "none"]["per_image"]]
                for name in (str(far), entry["minus"])
            )
            values = [a - b for a, b in zip(own, other, strict=True)]
            assert interval["mean"] == pytest.approx(sum(values) / 2)
            # Of two scenes with one image each, a quarter of the draws are one of them alone.
            assert interval["low"] == pytest.approx(min(values))
            assert interval["high"] == pytest.approx(max(values))
    assert _run(data, *arguments, "--html", str(page)) == ExitCode.OK
    title = (
        f"{far} minus each row: mean and 95 % interval over 2 scenes; ! excludes 0; of so few, the "
        "intervals are too narrow"
    )
    shown = capsys.readouterr().out
    assert f"\n\n{title}\n\nminus " in shown
    assert title in page.read_text()
    mean = document["differences"][-1]["intervals"]["abs_rel"]["mean"]
    cells = [line.split()[:4] for line in shown.splitlines() if line.startswith("default ")]
    assert cells[-1] == ["default", "none", "mean", f"{mean:+.4f}!"]
    assert f"<td>default</td><td>none</td><td>mean</td><td>{mean:+.4f}!</td>" in page.read_text()


@pytest.mark.usefixtures("models")
def test_predictions_alone_leave_the_bundled_model_out(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(COUNT):
        cv2.imwrite(str(tmp_path / f"{i:04d}.png"), np.round(_depth_m(i) * 1000).astype(np.uint16))
    arguments = ["--split", "val", "--json", "--no-trivial", "--predictions", str(tmp_path)]
    assert _run(data, *arguments) == ExitCode.OK
    (row,) = _rows(capsys)
    assert row["scores"]["abs_rel"] < 1e-3


def test_inverse_depth_needs_alignment(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(COUNT):
        np.save(tmp_path / f"{i:04d}.npy", 7 / _depth_m(i) + 2)
    arguments = ["--split", "val", "--no-trivial", "--json", "--predictions", str(tmp_path)]
    arguments += ["--predictions-kind", "inverse"]
    assert _run(data, *arguments) == ExitCode.USAGE
    assert "add --align disparity" in capsys.readouterr().err
    assert _run(data, *arguments, "--align", "disparity") == ExitCode.OK
    (row,) = _rows(capsys)
    assert row["align"] == "disparity"
    assert row["scores"]["abs_rel"] < 1e-3


def test_relative_model_needs_alignment(
    data: Path, models: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    relative = {"output__kind": "relative", "output__min_m": None, "output__max_m": None}
    write_model(models / "relative", **relative)
    arguments = ["--split", "val", "--model", "relative", "--no-trivial", "--json"]
    assert _run(data, *arguments) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert "relative gives relative depth" in error
    assert "--align depth" in error
    assert _run(data, *arguments, "--align", "depth") == ExitCode.OK
    assert _rows(capsys)[0]["scores"]["abs_rel"] < 0.03


VARIANTS = {
    "pooled average": ["--average", "pooled"],
    "eigen crop": ["--crop", "eigen"],
    "compared at 256×256": ["--compare-at", "256"],
    "raw-valid mask": ["--mask", "raw"],
}


@pytest.mark.parametrize("name", VARIANTS)
def test_each_variant_changes_the_numbers_and_the_name(
    name: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "nyu"
    shutil.copytree(data, copy)
    (copy / "raw_depth").mkdir()
    for i in range(COUNT):
        # Holes in one image only, so that images have different numbers of valid pixels.
        depth = cv2.imread(str(copy / "depth" / f"{i:04d}.png"), cv2.IMREAD_UNCHANGED)
        depth[: 400 if i == 3 else 5] = 0
        cv2.imwrite(str(copy / "raw_depth" / f"{i:04d}.png"), depth)
        if name == "pooled average":
            cv2.imwrite(str(copy / "depth" / f"{i:04d}.png"), depth)
    documents = []
    for extra in ([], VARIANTS[name]):
        assert _run(copy, "--split", "val", "--no-model", "--json", *extra) == ExitCode.OK
        documents.append(json.loads(capsys.readouterr().out))
    headline, variant = documents
    assert headline["protocol"]["name"] == "headline"
    assert variant["protocol"]["name"] == name
    assert headline["rows"][2]["scores"] != variant["rows"][2]["scores"]


def test_csv_file(data: Path, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    assert _run(data, "--split", "val", "--no-model", "--csv", str(path)) == ExitCode.OK
    with path.open() as file:
        lines = list(csv.DictReader(file))
    assert [line["align"] for line in lines] == ["none", "median"] * 2
    assert [item.name for item in tmp_path.iterdir()] == ["table.csv"]


def test_csv_that_cannot_be_written(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    path = tmp_path / "file" / "table.csv"
    code = _run(data, "--split", "val", "--no-model", "--csv", str(path))
    assert code == ExitCode.SOME_FAILED
    output = capsys.readouterr()
    assert "per-pixel mean" in output.out
    assert output.err.splitlines()[-1].startswith("depthcli: error: ")


def test_paper_split_of_the_first_thousand(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _run(data, "--no-model") == ExitCode.USAGE
    output = capsys.readouterr()
    assert output.out == ""
    assert len(output.err.splitlines()) == 1
    assert "use --split val" in output.err


def test_scores_of_each_image(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--split", "val", "--no-model", "--json"]
    assert _run(data, *arguments, "--per-image") == ExitCode.OK
    split = split_nyu(open_nyu(data), SplitName.VAL)
    expected = [f"{i:04d}" for i in split.test]
    assert [image["id"] for image in _rows(capsys)[0]["per_image"]] == expected
    assert _run(data, *arguments) == ExitCode.OK
    assert "per_image" not in _rows(capsys)[0]


def test_quiet_and_json_say_nothing_on_the_side(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ("--quiet", "--json"):
        assert _run(data, "--split", "val", "--no-model", option) == ExitCode.OK
        assert capsys.readouterr().err == ""


def test_data_may_come_from_the_environment(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DEPTHCLI_NYU", str(data))
    arguments = ["eval", "nyu", "--split", "val", "--no-model", "--limit", "1"]
    assert main(arguments) == ExitCode.OK
    assert "1 of 134 images" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--model", "default", "--no-model"], "exclude each other"),
        (["--no-model", "--per-image"], "add --json"),
        (["--split", "val", "--no-model", "--no-trivial"], "nothing to compare; give --model or"),
        (["--predictions", ".", "--predictions-kind", "feet", "--split", "val"], "feet is not"),
        (["--split", "test"], "'test' is not one of"),
        (
            ["--split", "val", "--no-model", "--against", "CUT (paper)"],
            "--against: CUT (paper) is not a row; choose from constant mean, per-pixel mean",
        ),
        (
            ["--split=val", "--no-model", "--average=pooled", "--against=constant mean"],
            "remove --average pooled",
        ),
        (["--limit", "0"], "limit"),
    ],
)
def test_usage_errors(
    arguments: list[str], message: str, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(data, *arguments) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


def test_data_is_required(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DEPTHCLI_NYU", raising=False)
    assert main(["eval", "nyu"]) == ExitCode.USAGE
    assert "--data" in capsys.readouterr().err


def test_a_terminal_gets_a_bar(data: Path) -> None:
    arguments = ["eval", "nyu", "--data", str(data), "--split", "val", "--no-model"]
    call = f"import sys; from depthcli.cli.app import main; sys.exit(main({arguments!r}))"
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "rb", buffering=0) as terminal:
        done = subprocess.run(
            [sys.executable, "-c", call],
            stdout=subprocess.PIPE,
            stderr=theirs,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
            check=False,
            timeout=60,
        )
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # how a closed terminal reads on Linux
            while piece := terminal.read(4096):
                shown += piece
    assert done.returncode == ExitCode.OK
    assert b"comparing" in shown
    assert b"2/2" in shown
    assert b"comparing" not in done.stdout


def test_sheets_and_page(
    data: Path, models: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = write_model(models / "far", output__shift=6.0)
    page, sheets = tmp_path / "new" / "page.html", tmp_path / "sheets"
    arguments = ["--split", "val", "--model", "default", "--model", str(far)]
    arguments += ["--html", str(page), "--figures", str(sheets)]
    assert _run(data, *arguments) == ExitCode.OK
    shown = capsys.readouterr()
    assert f"{sheets / 'depth-gray.png'}" in shown.err
    text = page.read_text()
    for line in shown.out.splitlines()[4:10]:
        for cell in line.split()[-9:]:
            assert f"<td>{cell}</td>" in text
    assert "protocol: headline" in text
    assert text.count("data:image/png;base64,") == 2
    ids = split_nyu(open_nyu(data), SplitName.VAL).test
    assert all(f"{i:04d}" in text for i in ids)
    assert sorted(path.name for path in sheets.iterdir()) == ["depth-colour.png", "depth-gray.png"]


def test_page_without_models_has_the_table_alone(data: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert _run(data, "--split", "val", "--no-model", "--html", str(page)) == ExitCode.OK
    text = page.read_text()
    assert "per-pixel mean" in text
    assert "<img" not in text


@pytest.mark.usefixtures("models")
@pytest.mark.parametrize(
    ("words", "code", "problem"),
    [
        (("--provider", "tensorrt"), ExitCode.FAILURE, "tensorrt"),
        (("--provider", "gpu"), ExitCode.USAGE, "no provider named 'gpu'"),
        (("--provider-option", "device_id"), ExitCode.USAGE, "not KEY=VALUE"),
        (("--provider-option", "device_id=1"), ExitCode.USAGE, "takes no options"),
    ],
)
def test_the_provider_and_its_options_are_those_of_predict(
    data: Path,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    code: ExitCode,
    problem: str,
) -> None:
    assert _run(data, "--split", "val", "--limit", "1", *words) == code
    assert problem in capsys.readouterr().err
