"""``depthcli eval pairs``: models compared on a folder of one's own."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.tiny import write_image, write_model
from PIL import Image

from depthcli.cli.app import main
from depthcli.core.camera import focal_px_of_hfov
from depthcli.errors import ExitCode
from depthcli.lab.evaluation.evaluate import scene_interval

WIDTH, HEIGHT, HFOV_DEG = 160, 120, 60.0
FOCAL_PX = focal_px_of_hfov(HFOV_DEG, WIDTH)
FACTORS = {"hall/a": 1.0, "hall/b": 2.0, "yard/c": 0.5}
"""How many times the focal length that the model learned took each image."""


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """What the tiny model says of each image, if it were of its own camera, times the factor."""
    rows = np.linspace(0, 1, HEIGHT, dtype=np.float32)[:, None]
    value = np.round(255 * (0.1 + 0.3 * rows) * np.ones((1, WIDTH), np.float32)).astype(np.uint8)
    lines = ["id,focal_px"]
    for name, factor in FACTORS.items():
        write_image(tmp_path / f"own/rgb/{name}.png", np.dstack([value] * 3))
        depth_m = (1 + 8 * value.astype(np.float32) / 255) * factor
        millimetres = np.round(depth_m * 1000).astype(np.uint16)
        write_image(tmp_path / f"own/depth/{name}.png", millimetres)
        lines.append(f"{name},{FOCAL_PX * factor}")
    (tmp_path / "own/cameras.csv").write_text("\n".join(lines))
    write_model(tmp_path / "tiny", camera={"hfov_deg": HFOV_DEG})
    return tmp_path / "own"


def _millimetres(data: Path) -> dict[str, Any]:
    """The depth of each image; makes folders for files of another tool."""
    for name in FACTORS:
        (data.parent / "files" / name).parent.mkdir(parents=True, exist_ok=True)
    depths = (cv2.imread(str(data / f"depth/{name}.png"), cv2.IMREAD_UNCHANGED) for name in FACTORS)
    return dict(zip(FACTORS, depths, strict=True))


def _row(data: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    document, _ = _table(capsys, str(data), "--model", str(data.parent / "tiny"), *more)
    (row,) = document["rows"]
    assert document["dataset"] == "own"
    is_known = (data / "cameras.csv").exists()
    assert len(document["notes"]) == 2 - is_known
    return row


def test_predictions_are_scaled_to_the_focal_length_of_each_image(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _row(data, capsys)["scores"]["abs_rel"] < 0.03
    (data / "cameras.csv").unlink()
    scores = _row(data, capsys)["scores"]
    assert scores["abs_rel"] == pytest.approx((0 + 0.5 + 1) / 3, abs=0.03)


def test_depth_up_to_the_farthest_counts(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (data / "cameras.csv").unlink()
    row = _row(data, capsys, "--max-depth", "3.5")
    assert (row["images"], row["images_without_valid_pixel"]) == (2, 1)  # the second: from 3.6 m
    assert row["scores"]["abs_rel"] == pytest.approx((0 + 1) / 2, abs=0.1)


def test_predictions_scale_is_not_png_scale(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, millimetres in _millimetres(data).items():
        for path in (data.parent / f"files/{name}.png", data / f"depth/{name}.png"):
            cv2.imwrite(str(path), np.round(millimetres * 0.256).astype(np.uint16))
    words = ["eval", "pairs", str(data), "--png-scale", "256", "--json"]
    words += ["--predictions", str(data.parent / "files")]
    for more, best, worst in (([], 0.7, 0.8), (["--predictions-scale", "256"], 0, 0)):
        assert main([*words, *more]) == ExitCode.OK
        captured = capsys.readouterr()
        assert best <= json.loads(captured.out)["rows"][0]["scores"]["abs_rel"] <= worst
        assert ("millimetres are assumed" in captured.err) is (not more)


@pytest.mark.parametrize(
    ("index", "scenes"),
    [
        (None, ["hall", "hall", "yard"]),
        (["x", "y", "y"], ["x", "y", "y"]),
        (["", "", ""], ["a", "b", "c"]),
    ],
)
def test_folders_or_the_scenes_of_an_index_are_resampled(
    data: Path, index: list[str] | None, scenes: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if index is not None:
        lines = [f"{name},{scene}," for name, scene in zip(FACTORS, index, strict=True)]
        (data / "index.csv").write_text("\n".join(["id,scene,official_split", *lines]))
    tiny, far = str(data.parent / "tiny"), str(write_model(data.parent / "far", output__shift=6.0))
    page = data.parent / "page.html"
    words = ["eval", "pairs", str(data), "--model", tiny, "--model", far, "--against", far]
    assert main([*words, "--json", "--per-image", "--html", str(page)]) == ExitCode.OK
    document = json.loads(capsys.readouterr().out)
    tiny_rmse, far_rmse = (
        np.array([image["rmse"] for image in row["per_image"]]) for row in document["rows"]
    )
    expected = scene_interval(far_rmse - tiny_rmse, scenes)
    (entry,) = document["differences"]
    assert (entry["row"], entry["minus"]) == (far, tiny)
    assert entry["intervals"]["rmse"] == asdict(expected)
    assert f"{far} minus each row" in page.read_text()


def test_nyu_has_a_command_of_its_own(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Which knows its splits, and the pairs that models have learned."""
    for kind in ("rgb", "depth"):
        for i, name in enumerate(FACTORS):
            (data / kind / f"{name}.png").rename(data / kind / f"{i:04d}.png")
    (data / "cameras.csv").unlink()
    rows = [f"{i:04d},room,train" for i in range(len(FACTORS))]
    (data / "index.csv").write_text("\n".join(["id,scene,official_split", *rows]))
    assert main(["eval", "pairs", str(data)]) == ExitCode.USAGE
    assert "eval nyu" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--csv", "--html"])
def test_a_report_replaces_no_file_of_another_program(
    data: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    link = data.parent / "link.csv"
    link.symlink_to(data / "cameras.csv")
    before = link.read_bytes()
    words = ["eval", "pairs", str(data), "--model", str(data.parent / "tiny"), option, str(link)]
    assert main(words) == ExitCode.USAGE
    assert "link.csv" in capsys.readouterr().err
    assert link.read_bytes() == before


def test_a_report_in_the_data_set_is_replaced_by_the_next(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, page = data / "table.csv", data / "page.html"
    words = ["eval", "pairs", str(data), "--model", str(data.parent / "tiny"), "--quiet"]
    for _ in range(2):
        assert main([*words, "--csv", str(table), "--html", str(page)]) == ExitCode.OK
    assert capsys.readouterr() == ("", "")


def _table(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[dict[str, Any], str]:
    assert main(["eval", "pairs", *words, "--json"]) == ExitCode.OK
    captured = capsys.readouterr()
    return json.loads(captured.out), captured.err


def test_table_states_unit_and_who_says_it(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """SUN RGB-D stores eighths of a millimetre; as millimetres, all models are equally bad.

    Source: https://github.com/laughtervv/DepthAwareCNN/issues/34
    """
    for file in data.glob("depth/*/*.png"):
        millimetres = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), millimetres * 4)
    tiny = ("--model", str(data.parent / "tiny"))
    document, errors = _table(capsys, str(data), *tiny)
    unit, outside = document["notes"]
    assert "mm, assumed" in unit
    assert "10 m" in outside
    assert document["rows"][0]["scores"]["abs_rel"] > 0.5
    assert errors.count("--png-scale") == 1
    document, errors = _table(capsys, str(data), *tiny, "--png-scale", "4000")
    assert ["1/4000 m, given" in note for note in document["notes"]] == [True]
    (row,) = document["rows"]
    assert row["scores"]["abs_rel"] < 0.03
    assert (row["depth"], row["pixels"]) == ("metric, m", 3 * WIDTH * HEIGHT)
    assert "--png-scale" not in errors


def test_predictions_state_kind_and_unit(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Inverse depth in .npy is taken for metres, which the table says.

    Source: https://github.com/isl-org/Open3D/issues/671
    """
    files = data.parent / "files"
    for name, millimetres in _millimetres(data).items():
        np.save(files / f"{name}.npy", (1000 / millimetres).astype(np.float32))
    words = (str(data), "--predictions", str(files))
    (row,) = _table(capsys, *words)[0]["rows"]
    assert row["depth"] == "metric, m, assumed"
    assert row["images_with_reversed_order"] == 3
    assert "exchanged in 3 of 3 images" in row["note"]
    words += ("--predictions-kind", "inverse", "--align", "disparity")
    (row,) = _table(capsys, *words)[0]["rows"]
    assert row["depth"] == "inverse"
    assert row["scores"]["abs_rel"] < 0.01
    assert "note" not in row


def test_ray_distance_is_compared_along_the_axis(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = data.parent / "files"
    x, y = np.arange(WIDTH) - (WIDTH - 1) / 2, np.arange(HEIGHT) - (HEIGHT - 1) / 2
    for name, millimetres in _millimetres(data).items():
        longer = np.hypot(1, np.hypot(x, y[:, None]) / (FOCAL_PX * FACTORS[name]))
        np.save(files / f"{name}.npy", (millimetres / 1000 * longer).astype(np.float32))
    words = (str(data), "--predictions", str(files))
    document, _ = _table(capsys, *words, "--predictions-kind", "distance")
    assert document["rows"][0]["scores"]["abs_rel"] < 1e-3
    for name in FACTORS:
        (data / f"depth/{name}.png").unlink()
        (files / f"{name}.npy").rename(data / f"depth/{name}.npy")
    tiny = ("--model", str(data.parent / "tiny"))
    document, _ = _table(capsys, str(data), *tiny, "--depth-kind", "distance")
    assert document["rows"][0]["scores"]["abs_rel"] < 0.03


def test_disparity_is_compared_as_depth(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As of KITTI and Cityscapes, in 1/256 pixel."""
    files, baseline_m = data.parent / "files", 0.5
    for name, millimetres in _millimetres(data).items():
        disparity_px = FOCAL_PX * FACTORS[name] * baseline_m / (millimetres / 1000)
        cv2.imwrite(str(files / f"{name}.png"), np.rint(256 * disparity_px).astype(np.uint16))
    options = ("--predictions-kind", "disparity", "--predictions-scale", "256")
    words = (str(data), "--predictions", str(files), *options)
    document, _ = _table(capsys, *words, "--baseline", "0.5")
    assert document["rows"][0]["scores"]["abs_rel"] < 0.01
    assert main(["eval", "pairs", *words]) == ExitCode.USAGE
    for name in FACTORS:
        (files / f"{name}.png").replace(data / f"depth/{name}.png")
    truth = ("--depth-kind", "disparity", "--png-scale", "256")
    words = (str(data), *truth, "--model", str(data.parent / "tiny"))
    document, _ = _table(capsys, *words, "--baseline", "0.5")
    assert document["rows"][0]["scores"]["abs_rel"] < 0.03
    (data / "cameras.csv").unlink()
    assert main(["eval", "pairs", *words, "--baseline", "0.5"]) == ExitCode.USAGE


def test_pixels_without_depth_are_counted(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = data.parent / "files"
    for name in _millimetres(data):
        np.save(files / f"{name}.npy", np.full((HEIGHT, WIDTH), np.nan, np.float32))
    (row,) = _table(capsys, str(data), "--predictions", str(files))[0]["rows"]
    assert row["pixels_without_prediction"] == row["pixels"] > 0
    assert str(files) in row["note"]


def test_no_pixel_that_counts_is_an_error(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["eval", "pairs", str(data), "--model", str(data.parent / "tiny")]
    assert main([*words, "--min-depth", "90", "--max-depth", "99"]) == ExitCode.USAGE
    assert "90 and 99" in capsys.readouterr().err
    assert main([*words, "--min-depth", "10"]) == ExitCode.USAGE
    assert main([*words, "--rgb", "*.png"]) == ExitCode.USAGE


def test_patterns_need_no_index(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (data / "index.csv").write_text("filename,width\n")  # of another program
    words = (str(data), "--model", str(data.parent / "tiny"), "--depth", "depth/*/*.png")
    assert _table(capsys, *words, "--rgb", "rgb/*/*.png")[0]["rows"]


def test_crop_and_range_choose_pixels(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tiny = ("--model", str(data.parent / "tiny"))
    (row,) = _table(capsys, str(data), *tiny, "--crop", "garg")[0]["rows"]
    rows, columns = slice(48, 119), slice(5, 154)
    assert row["pixels"] == 3 * np.ones((HEIGHT, WIDTH))[rows, columns].sum()
    document, _ = _table(capsys, str(data), *tiny, "--min-depth", "6")
    assert any("between 6 and 10 m" in note for note in document["notes"])
    (row,) = _table(capsys, str(data), *tiny, "--min-depth", "3")[0]["rows"]
    depths = [cv2.imread(str(f), cv2.IMREAD_UNCHANGED) for f in data.glob("depth/*/*.png")]
    counted = sum(int(((d > 3000) & (d < 10_000)).sum()) for d in depths)
    assert row["pixels"] == counted


def test_model_trained_on_these_is_marked(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = write_model(data.parent / "seen", training={"data": "own pairs (own)"})
    (row,) = _table(capsys, str(data), "--model", str(model))[0]["rows"]
    assert str(model) in row["note"]
    (data / "cameras.csv").unlink()
    for i, name in enumerate(FACTORS):  # as a copy of NYU Depth v2 names them
        for kind in ("rgb", "depth"):
            pixels = cv2.imread(str(data / kind / f"{name}.png"), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(data / kind / f"000{i}.png"), cv2.resize(pixels, (640, 480)))
            (data / kind / f"{name}.png").unlink()
    nyu = write_model(data.parent / "nyu", training={"nyu_train_ids": "0001-0900"})
    (row,) = _table(capsys, str(data), "--model", str(nyu))[0]["rows"]
    assert "2 pairs of NYU" in row["note"]
    assert "images_trained_on" not in row


def test_exif_focal_length_scales_depth(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As predict does: images of a phone state it, and a folder of them has no cameras.csv."""
    (data / "cameras.csv").unlink()
    for name, factor in FACTORS.items():
        exif = Image.Exif()
        # Millimetres of a 36 × 24 mm film, whose diagonal the image's stands for.
        diagonal_px = float(np.hypot(WIDTH, HEIGHT))
        equivalent = factor * FOCAL_PX * float(np.hypot(36, 24)) / diagonal_px
        exif.get_ifd(0x8769)[0xA405] = round(equivalent)
        path = data / f"rgb/{name}.png"
        Image.open(path).save(path.with_suffix(".jpg"), exif=exif, quality=100)
        path.unlink()
    row = _row(data, capsys)
    assert row["scores"]["abs_rel"] < 0.05
