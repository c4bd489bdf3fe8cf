"""What ``--data`` of ``depthcli train`` may be."""

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest

from depthcli.datasets.base import SplitName, split_nyu
from depthcli.datasets.nyu import open_nyu
from depthcli.datasets.training_data import open_training_data
from depthcli.errors import DatasetError
from depthcli.training.config import DataConfig
from depthcli.training.provenance import train_val_split


def _fill(folder: Path, images: list[str], depths: list[str]) -> Path:
    for kind, names in (("rgb", images), ("depth", depths)):
        for number, name in enumerate(names):
            file = folder / kind / f"{name}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            picture = np.full((6, 8, 3), number, np.uint8)
            depth = np.full((4, 4) if name[0] == "z" else (6, 8), 1000 + number, np.uint16)
            assert cv2.imwrite(str(file), picture if kind == "rgb" else depth)
    return folder


@pytest.mark.parametrize("paired", [True, False])
def test_same_names_are_pairs(tmp_path: Path, *, paired: bool) -> None:
    names = ["hall/1", "hall/2", "lab/1"]
    dataset = open_training_data(_fill(tmp_path, names, names), paired=paired).dataset
    assert dataset.paired
    assert dataset.scenes == ("hall", "hall", "lab")


def test_other_names_are_two_lists_and_the_shorter_begins_again(tmp_path: Path) -> None:
    folder = _fill(tmp_path, ["a", "b", "c", "d", "e"], ["z1", "z2"])
    dataset = open_training_data(folder, paired=False).dataset
    assert not dataset.paired
    assert len(dataset) == len(dataset.ids) == len(set(dataset.ids)) == 5
    assert [int(dataset.image(i)[0, 0, 0]) for i in range(5)] == [0, 1, 2, 3, 4]
    assert [round(float(dataset.depth_m(i)[0, 0]), 3) for i in range(5)] == [1, 1.001] * 2 + [1]
    assert set(dataset.scenes) == set(dataset.official_split) == {""}


def _nyu(folder: Path, rows: list[str]) -> Path:
    """A folder with an index of ``ID,scene,official_split`` rows."""
    names = [row.partition(",")[0] for row in rows]
    _fill(folder, names, names)
    (folder / "index.csv").write_text("\n".join(["id,scene,official_split", *rows, ""]))
    return folder


ROWS = ["0003,attic,test", "0999,attic,train", "1000,bath,train", "1448,den,test"]


@pytest.mark.parametrize(
    ("split", "ids", "title"),
    [
        ("paper", ("0003", "0999"), "NYU Depth v2, labelled pairs 1-1000"),
        ("official", ("0999", "1000"), "NYU Depth v2, the official split's training pairs"),
    ],
)
def test_no_split_trains_on_its_test_part(
    tmp_path: Path, split: Literal["paper", "official"], ids: tuple[str, ...], title: str
) -> None:
    whole = open_nyu(_nyu(tmp_path, ROWS))
    data = open_training_data(tmp_path, paired=True, split=split)
    assert (data.dataset.ids, data.title, data.hfov_deg) == (ids, title, 63.3)
    for i, name in enumerate(ids):
        j = list(whole.ids).index(name)
        assert data.dataset.scenes[i] == whole.scenes[j]
        assert data.dataset.official_split[i] == whole.official_split[j]
        np.testing.assert_array_equal(data.dataset.image(i), whole.image(j))
        np.testing.assert_array_equal(data.dataset.depth_m(i), whole.depth_m(j))


def test_held_out_pairs_are_the_val_split(tmp_path: Path) -> None:
    rows = [f"{label:04d},scene-{label // 3:03d},train" for label in range(0, 1449, 23)]
    whole = open_nyu(_nyu(tmp_path, rows))
    data = open_training_data(tmp_path, paired=True).dataset
    train, held_out = train_val_split(data, DataConfig())
    split = split_nyu(whole, SplitName.VAL)
    assert [data.ids[i] for i in held_out] == [whole.ids[i] for i in split.test]
    assert [data.ids[i] for i in train] == [whole.ids[i] for i in split.train]
    assert not {data.ids[i] for i in train} & {
        whole.ids[i] for i in split_nyu(whole, SplitName.PAPER).test
    }


def test_only_test_pairs_are_nothing_to_train_on(tmp_path: Path) -> None:
    with pytest.raises(DatasetError):
        open_training_data(_nyu(tmp_path, ROWS[2:]), paired=True)


def test_an_index_with_names_that_are_no_numbers_of_nyu_is_one_s_own(tmp_path: Path) -> None:
    data = open_training_data(_nyu(tmp_path, ["0000,attic,", "1449,den,"]), paired=True)
    assert len(data.dataset) == 2
    assert (data.title, data.hfov_deg) == (f"own pairs ({tmp_path.name})", None)


OWN = ["a,attic,test", "b,attic,train", "c,bath,train"]


def test_an_index_of_one_s_own_leaves_cameras_and_units_in_force(tmp_path: Path) -> None:
    """It adds scenes and split to what the same folder is without it."""
    folder = _fill(tmp_path, ["a", "b", "c"], ["a", "b", "c"])
    (folder / "cameras.csv").write_text("id,focal_px\na,10\nb,20\nc,40\n")
    plain = open_training_data(folder, paired=True, units_per_metre=50)  # 20 m: no room of NYU's
    data = open_training_data(_nyu(folder, OWN), paired=True, units_per_metre=50)
    assert (data.title, data.hfov_deg) == (plain.title, plain.hfov_deg) == (data.title, 63.3)
    assert data.dataset.scenes == ("attic", "attic", "bath")
    for i in range(3):
        np.testing.assert_array_equal(data.dataset.depth_m(i), plain.dataset.depth_m(i))
    assert data.dataset.depth_m(1)[0, 0] * 20 == pytest.approx(1001 / 50 * 6.4894, rel=1e-4)


def test_the_official_split_of_one_s_own_is_the_pairs_that_its_index_names(tmp_path: Path) -> None:
    folder = _nyu(tmp_path, OWN)
    (folder / "cameras.csv").write_text("id,focal_px\na,10\nb,20\nc,40\n")
    whole = open_training_data(folder, paired=True)
    data = open_training_data(folder, paired=True, split="official")
    assert (whole.dataset.ids, data.dataset.ids) == (("a", "b", "c"), ("b", "c"))
    np.testing.assert_array_equal(data.dataset.depth_m(0), whole.dataset.depth_m(1))
    (folder / "index.csv").unlink()
    with pytest.raises(DatasetError):
        open_training_data(folder, paired=True, split="official")


def test_the_camera_of_nyu_is_known(tmp_path: Path) -> None:
    rows = [f"{row[:4]},9" for row in ROWS]
    (_nyu(tmp_path, ROWS) / "cameras.csv").write_text("\n".join(["id,focal_px", *rows]))
    with pytest.raises(DatasetError):
        open_training_data(tmp_path, paired=True)


def test_same_names_and_other_sizes_are_two_lists(tmp_path: Path) -> None:
    folder = _fill(tmp_path, ["z1", "z2"], ["z1", "z2"])
    assert not open_training_data(folder, paired=False).dataset.paired
    with pytest.raises(DatasetError):
        open_training_data(folder, paired=True)


def test_the_unit_of_one_s_own_depth(tmp_path: Path) -> None:
    names = ["a", "b"]
    folder = _fill(tmp_path, names, names)
    data = open_training_data(folder, paired=True, units_per_metre=256)
    assert float(data.dataset.depth_m(0)[0, 0]) == 1000 / 256
    assert not data.warnings
    for paired in (True, False):  # millimetres are assumed
        (warning,) = open_training_data(folder, paired=paired).warnings
        assert "data.units_per_metre" in warning
    with pytest.raises(DatasetError):
        open_training_data(_nyu(tmp_path / "nyu", ROWS), paired=True, units_per_metre=256)


def test_linked_scenes_are_followed(tmp_path: Path) -> None:
    _fill(tmp_path / "far", ["1", "2"], ["1", "2"])
    for kind in ("rgb", "depth"):
        (tmp_path / kind).mkdir()
        (tmp_path / kind / "near").symlink_to(tmp_path / "far" / kind)
    data = open_training_data(tmp_path, paired=True).dataset
    assert data.ids == ("near/1", "near/2")


@pytest.mark.parametrize("paired", [True, False])
def test_missing_data_is_an_error(tmp_path: Path, *, paired: bool) -> None:
    with pytest.raises(DatasetError):
        open_training_data(tmp_path / "none", paired=paired)
    with pytest.raises(DatasetError):
        open_training_data(tmp_path, paired=paired)
