from pathlib import Path

import numpy as np
import pytest
from helpers.small_set import small_set
from helpers.tiny import write_image

from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import DatasetError
from depthcli.io.formats.table import Format, writer_class
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.lab.datasets.folders import open_paired_folder
from depthcli.lab.evaluation.predictors import Sample, open_predictions

IDS = ("0000", "0001")
SAMPLES = [Sample(small_set(), i) for i in (0, 1)]


def _write_npy(folder: Path, value: float = 2.0) -> None:
    for name in IDS:
        np.save(folder / f"{name}.npy", np.full((4, 6), value, np.float32))


def _write_png(folder: Path, value: int = 3000) -> None:
    for name in IDS:
        write_image(folder / f"{name}.png", np.full((4, 6), value, np.uint16))


def test_a_scale_is_for_files_that_state_none(tmp_path: Path) -> None:
    png, integers, tagged = (tmp_path / name for name in ("png", "npy", "stated"))
    for folder in (integers, tagged):
        folder.mkdir()
    _write_png(png, 768)
    for name in IDS:
        np.save(integers / f"{name}.npy", np.full((4, 6), 768, np.uint16))
        writer = writer_class(Format.PNG16)()
        writer.write(DepthMap(np.full((4, 6), 3.0, np.float32)), tagged / f"{name}.png")
    for folder in (png, integers, tagged):
        predictor = open_predictions(folder, SAMPLES, DepthReadOptions(unstated_scale=256))
        assert (predictor.predict(Sample(small_set(), 1)).values == 3.0).all()
        assert not predictor.warnings
    assumed = open_predictions(png, SAMPLES)
    assert assumed.stated == "metric, mm, assumed"
    assert len(assumed.warnings) == 1
    assert not open_predictions(
        png, SAMPLES, DepthReadOptions(kind=DepthEncoding.RELATIVE)
    ).warnings
    assert not open_predictions(tagged, SAMPLES).warnings


def test_metric_integers_are_refused(tmp_path: Path) -> None:
    """Nobody can tell millimetres from other units; errors of other kinds do not depend on it."""
    for dataset_id in IDS:
        np.save(tmp_path / f"{dataset_id}.npy", np.full((4, 4), 2206, np.uint16))
    for kind in (None, DepthEncoding.METRIC):
        with pytest.raises(DatasetError):
            open_predictions(tmp_path, SAMPLES, DepthReadOptions(kind=kind)).predict(
                Sample(small_set(), 0)
            )
    relative = open_predictions(
        tmp_path, SAMPLES, DepthReadOptions(kind=DepthEncoding.RELATIVE)
    ).predict(Sample(small_set(), 0))
    np.testing.assert_array_equal(relative.values, np.full((4, 4), 2206))


def test_missing_prediction_is_an_error(tmp_path: Path) -> None:
    _write_npy(tmp_path)
    (tmp_path / "0001.npy").unlink()
    for folder, reason in ((tmp_path, r"0001\.npy"), (tmp_path / "none", "none")):
        with pytest.raises(DatasetError, match=reason):
            open_predictions(folder, SAMPLES)


@pytest.mark.parametrize("position", [0, 1])
def test_damaged_prediction(tmp_path: Path, position: int) -> None:
    _write_npy(tmp_path)
    (tmp_path / f"{IDS[position]}.npy").write_bytes(b"not numpy")
    with pytest.raises(DatasetError, match=IDS[position]):
        open_predictions(tmp_path, SAMPLES, DepthReadOptions(kind=DepthEncoding.METRIC)).predict(
            Sample(small_set(), position)
        )
    if position == 0:  # whose kind is asked for
        with pytest.raises(DatasetError, match=IDS[0]):
            open_predictions(tmp_path, SAMPLES)


def test_a_kind_is_for_files_that_state_none(tmp_path: Path) -> None:
    depth = DepthMap(np.full((4, 6), 2.5, np.float32))
    for name in IDS:
        writer_class(Format.EXR)().write(depth, tmp_path / f"{name}.exr")
    predictor = open_predictions(tmp_path, SAMPLES, DepthReadOptions(kind=DepthEncoding.INVERSE))
    assert predictor.kind is DepthKind.METRIC
    assert predictor.predict(Sample(small_set(), 1)).kind is DepthKind.METRIC


def test_files_of_two_kinds_are_an_error(tmp_path: Path) -> None:
    for name, kind in zip(IDS, (DepthKind.METRIC, DepthKind.INVERSE), strict=True):
        depth = DepthMap(np.full((4, 6), 2.5, np.float32), kind)
        writer_class(Format.EXR)().write(depth, tmp_path / f"{name}.exr")
    predictor = open_predictions(tmp_path, SAMPLES)
    assert predictor.predict(Sample(small_set(), 0)).kind is DepthKind.METRIC
    with pytest.raises(DatasetError, match=r"0001\.exr"):
        predictor.predict(Sample(small_set(), 1))


def test_a_stray_file_does_not_stand_for_the_others(tmp_path: Path) -> None:
    _write_png(tmp_path)
    np.save(tmp_path / f"{IDS[0]}.npy", np.full((4, 6), 9, np.float32))
    predictor = open_predictions(tmp_path, SAMPLES)
    assert (predictor.predict(Sample(small_set(), 0)).values == 3).all()


SEVEN = ("frame-{}.color.png", "frame-{}.depth.png")
SELECTED = (
    "image/a_sync_image_{}_image_02.png",
    "groundtruth_depth/a_sync_groundtruth_depth_{}_image_02.png",
)
DRIVE = ("{}_sync/image_02/data/1.png", "{}_sync/proj_depth/groundtruth/image_02/1.png")
PATTERN = ("left/{}_left.png", "gt/{}_gt.png")


def _samples(root: Path, names: tuple[str, str], patterns: tuple[str, str] | None) -> list[Sample]:
    """Two pairs, 1 and 2."""
    for name, pixels in zip(names, (np.zeros((4, 6, 3)), np.full((4, 6), 999)), strict=True):
        for number in "12":
            write_image(root / name.format(number), pixels.astype(np.uint16))
    dataset = open_paired_folder(root, patterns=patterns)
    return [Sample(dataset, i) for i in (0, 1)]


def _predict(folder: Path, name: str) -> None:
    for number in "12":
        file = folder / name.format(number)
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, np.full((4, 6), int(number), np.float32))


@pytest.mark.parametrize(
    ("names", "prediction"),
    [
        (SEVEN, "frame-{}.npy"),
        (SEVEN, "frame-{}.color.depth.npy"),
        (SELECTED, "a_sync/{}_image_02.npy"),
        (SELECTED, "a_sync_image_{}_image_02.depth.npy"),
        (SELECTED, "image/a_sync_image_{}_image_02.npy"),
        (DRIVE, "{}_sync/image_02/1.npy"),
        (DRIVE, "{}_sync/image_02/data/1.depth.npy"),
        (PATTERN, "{}.npy"),
        (PATTERN, "{}_left.depth.npy"),
    ],
)
def test_predictions_are_named_by_id_or_as_the_image(
    names: tuple[str, str], prediction: str, tmp_path: Path
) -> None:
    """KITTI's devkit and ``batch`` name them as the image."""
    patterns = (names[0].format("*"), names[1].format("*")) if names is PATTERN else None
    samples = _samples(tmp_path / "data", names, patterns)
    _predict(tmp_path / "files", prediction)
    predictor = open_predictions(tmp_path / "files", samples)
    assert [predictor.predict(sample).values.max() for sample in samples] == [1, 2]


def test_the_name_of_two_images_is_not_that_of_one(tmp_path: Path) -> None:
    samples = _samples(tmp_path / "data", DRIVE, None)
    _predict(tmp_path / "files", "1.npy")
    with pytest.raises(DatasetError):
        open_predictions(tmp_path / "files", samples[:1])


def test_two_predictions_of_one_image_are_an_error(tmp_path: Path) -> None:
    samples = _samples(tmp_path / "data", SEVEN, None)
    for name in ("frame-{}.npy", "frame-{}.color.npy"):
        _predict(tmp_path / "files", name)
    with pytest.raises(DatasetError, match=r"frame-1\.npy"):
        open_predictions(tmp_path / "files", samples)
