from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from depthcli.datasets.folders import open_paired_folder, open_unpaired_folder
from depthcli.errors import DatasetError
from depthcli.io.depth.read import DepthReadOptions


def _write(path: Path, value: int, *, depth: bool, size: tuple[int, int] = (6, 8)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full(size, value, np.uint16) if depth else np.full((*size, 3), value, np.uint8)
    assert cv2.imwrite(str(path), pixels)


def test_subfolders_are_scenes(tmp_path: Path) -> None:
    for i, name in enumerate(["hall/1", "hall/2", "lab/1"]):
        _write(tmp_path / "rgb" / f"{name}.png", 10 * i, depth=False)
        _write(tmp_path / "depth" / f"{name}.png", 1000 * (i + 1), depth=True)
    dataset = open_paired_folder(tmp_path)
    assert dataset.ids == ("hall/1", "hall/2", "lab/1")
    assert dataset.scenes == ("hall", "hall", "lab")
    assert dataset.official_split == ("", "", "")
    assert [float(dataset.depth_m(i)[0, 0]) for i in range(3)] == [1.0, 2.0, 3.0]
    assert [int(dataset.image(i)[0, 0, 0]) for i in range(3)] == [0, 10, 20]


def test_predicted_depth_belongs_to_its_picture(tmp_path: Path) -> None:
    _write(tmp_path / "rgb" / "hall" / "a.png", 10, depth=False)
    _write(tmp_path / "depth" / "hall" / "a.depth.png", 2000, depth=True)
    dataset = open_paired_folder(tmp_path)
    assert (dataset.ids, float(dataset.depth_m(0)[0, 0])) == (("hall/a",), 2.0)
    _write(tmp_path / "depth" / "hall" / "a.png", 2000, depth=True)
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path)


def test_other_unit(tmp_path: Path) -> None:
    _write(tmp_path / "rgb" / "a.jpg", 10, depth=False)
    _write(tmp_path / "depth" / "a.png", 512, depth=True)
    assert open_paired_folder(tmp_path, DepthReadOptions(256)).depth_m(0)[0, 0] == 2.0


def test_depth_that_cannot_be_millimetres(tmp_path: Path) -> None:
    _write(tmp_path / "rgb" / "a.jpg", 10, depth=False)
    _write(tmp_path / "depth" / "a.png", 20, depth=True)
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path)


def test_hidden_files_and_folders_are_passed_over(tmp_path: Path) -> None:
    _write(tmp_path / "rgb" / "a.jpg", 10, depth=False)
    _write(tmp_path / "depth" / "a.png", 2000, depth=True)
    (tmp_path / "rgb" / "._a.jpg").write_bytes(b"resource fork")
    (tmp_path / "rgb" / "b.png").mkdir()
    (tmp_path / "depth" / "notes.txt").write_text("hello")
    assert open_paired_folder(tmp_path).ids == ("a",)


def test_depth_of_another_size_is_compared_in_the_view_of_its_image(tmp_path: Path) -> None:
    """As in ScanNet, where the two cameras have sizes of their own."""
    _write(tmp_path / "rgb" / "a.png", 10, depth=False, size=(12, 16))
    halves = np.repeat(np.uint16([[1000, 3000]]), 4, axis=1) * np.ones((6, 1), np.uint16)
    (tmp_path / "depth").mkdir()
    assert cv2.imwrite(str(tmp_path / "depth" / "a.png"), halves)
    depth_m = open_paired_folder(tmp_path).depth_m(0)
    np.testing.assert_array_equal(depth_m, np.repeat([[1.0, 3.0]], 8, axis=1) * np.ones((12, 1)))
    _write(tmp_path / "rgb" / "a.png", 10, depth=False, size=(12, 12))
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path)


def test_image_that_is_turned_upright_needs_upright_depth(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    (tmp_path / "rgb").mkdir()
    Image.new("RGB", (16, 12)).save(tmp_path / "rgb" / "a.jpg", exif=exif)
    _write(tmp_path / "depth" / "a.png", 2000, depth=True, size=(16, 12))
    dataset = open_paired_folder(tmp_path)
    assert dataset.image(0).shape[:2] == dataset.depth_m(0).shape == (16, 12)
    _write(tmp_path / "depth" / "a.png", 2000, depth=True, size=(12, 16))
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path)


def test_unpaired_lists_are_independent(tmp_path: Path) -> None:
    for name in ("x", "y", "z"):
        _write(tmp_path / "rgb" / f"{name}.jpg", 10, depth=False)
    _write(tmp_path / "depth" / "other.png", 3000, depth=True, size=(4, 4))
    dataset = open_unpaired_folder(tmp_path)
    assert dataset.ids == ("x.jpg other.png", "y.jpg other.png", "z.jpg other.png")
    assert dataset.image(2).shape == (6, 8, 3)
    assert dataset.depth_m(0)[0, 0] == 3.0


@pytest.mark.parametrize("depth", [None, np.uint16(3), np.uint8(9)])  # none, in metres, in 8 bits
def test_unpaired_folder_without_depth_in_millimetres(
    depth: np.generic | None, tmp_path: Path
) -> None:
    _write(tmp_path / "rgb" / "a.jpg", 10, depth=False)
    (tmp_path / "depth").mkdir()
    if depth is not None:
        assert cv2.imwrite(str(tmp_path / "depth" / "b.png"), np.full((4, 4), depth))
    with pytest.raises(DatasetError):
        open_unpaired_folder(tmp_path)
