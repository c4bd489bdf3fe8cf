"""Folders of data sets as they are distributed."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.core.camera import Intrinsics
from depthcli.datasets.base import Pair
from depthcli.datasets.folders import in_view, open_paired_folder
from depthcli.datasets.layouts import list_pairs
from depthcli.datasets.training_data import open_training_data
from depthcli.errors import DatasetError, UsageError
from depthcli.io.depth.read import DepthReadOptions
from depthcli.training.config import DataConfig
from depthcli.training.provenance import train_val_split


def _image(root: Path, *names: str, size: tuple[int, int] = (6, 8)) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(root / name), np.full((*size, 3), 9, np.uint8))


def _depth(root: Path, *names: str, units: int = 2000, size: tuple[int, int] = (6, 8)) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(root / name), np.full(size, units, np.uint16))


def _listed(root: Path, **more: tuple[str, str]) -> dict[str, tuple[str, str]]:
    pairs = list_pairs(root, **more).pairs
    return {
        pair.id: (pair.image.relative_to(root).as_posix(), pair.depth.relative_to(root).as_posix())
        for pair in pairs
    }


def test_associations_of_tum_pair_time_stamps_in_fifths_of_a_millimetre(tmp_path: Path) -> None:
    """Also with depth first, as some tools write them."""
    _image(tmp_path, "rgb/1.10.png", "rgb/2.20.png")
    _depth(tmp_path, "depth/1.11.png", "depth/2.21.png", units=10_000)
    lines = ["# time", "1.10 rgb/1.10.png 1.11 depth/1.11.png"]
    lines += ["2.21 depth/2.21.png 2.20 rgb/2.20.png"]
    (tmp_path / "associations.txt").write_text("\n".join(lines))
    assert _listed(tmp_path) == {
        "1.10": ("rgb/1.10.png", "depth/1.11.png"),
        "2.20": ("rgb/2.20.png", "depth/2.21.png"),
    }
    dataset = open_paired_folder(tmp_path)
    assert (dataset.depth_m(0) == 2).all()
    assert dataset.warnings == ()
    millimetres = open_paired_folder(tmp_path, DepthReadOptions(1000))
    assert (millimetres.depth_m(0) == 10).all()
    assert (open_training_data(tmp_path, paired=True).dataset.depth_m(1) == 2).all()


def test_time_stamps_are_paired_with_the_nearest(tmp_path: Path) -> None:
    _image(tmp_path, *(f"rgb/{t}.png" for t in ("10.000", "10.033", "10.066", "12.000")))
    _depth(tmp_path, *(f"depth/{t}.png" for t in ("10.015", "10.030", "10.070")))
    listing = list_pairs(tmp_path)
    assert _listed(tmp_path) == {
        "10.033": ("rgb/10.033.png", "depth/10.030.png"),
        "10.066": ("rgb/10.066.png", "depth/10.070.png"),
        "10.000": ("rgb/10.000.png", "depth/10.015.png"),
    }
    assert (listing.left_out, listing.units_per_metre) == (1, None)
    (tmp_path / "rgb.txt").touch()
    assert list_pairs(tmp_path).units_per_metre == 5000


def test_scannet_has_two_cameras_of_their_own_size(tmp_path: Path) -> None:
    _image(tmp_path, "scene0000_00/color/0.jpg", size=(12, 16))
    _depth(tmp_path, "scene0000_00/depth/0.png")
    cameras = tmp_path / "scene0000_00/intrinsic"
    cameras.mkdir()
    for name, focal_px, centre in (("color", 20, (7.5, 5.5)), ("depth", 10, (3.5, 2.5))):
        matrix = np.diag([focal_px, focal_px, 1.0, 1.0])
        matrix[:2, 2] = centre
        np.savetxt(cameras / f"intrinsic_{name}.txt", matrix)
    dataset = open_paired_folder(tmp_path)
    assert dataset.ids == ("scene0000_00/0",)
    assert dataset.scenes == ("scene0000_00",)
    assert dataset.focal_px == (20.0,)
    assert dataset.depth_m(0).shape == (12, 16)
    assert (dataset.depth_m(0) == 2).all()


def test_depth_of_a_wider_camera_is_cut_to_the_view_of_the_image() -> None:
    """Twice the field of view: the middle half of the depth covers the image."""
    depth_m = np.arange(16 * 8, dtype=np.float32).reshape(8, 16)
    pair = Pair(
        "a",
        camera=Intrinsics(16, centre_px=(7.5, 3.5), pixel_aspect=1),
        depth_camera=Intrinsics(8, centre_px=(7.5, 3.5), pixel_aspect=1),
    )
    seen = in_view(depth_m, pair, (8, 16))
    for y in range(8):
        for x in range(16):
            column, row = (x - 7.5) / 2 + 7.5, (y - 3.5) / 2 + 3.5
            assert abs(seen[y, x] % 16 - column) <= 0.5
            assert abs(seen[y, x] // 16 - row) <= 0.5


def test_a_camera_of_another_size_is_not_used(tmp_path: Path) -> None:
    """Preprocessed ScanNet: images of 640×480 beside the camera of 1296×968."""
    _image(tmp_path, "color/0.jpg", size=(48, 64))
    _depth(tmp_path, "depth/0.png", size=(48, 64))
    for name, focal_px, centre in (("color", 117, (64.8, 48.4)), ("depth", 57.7, (31.9, 23.9))):
        matrix = np.diag([focal_px, focal_px, 1.0])
        matrix[:2, 2] = centre
        np.savetxt(tmp_path / f"intrinsics_{name}.txt", matrix)
    dataset = open_paired_folder(tmp_path)
    assert dataset.focal_px == ()
    assert any("cameras.csv" in warning for warning in dataset.warnings)
    assert (dataset.depth_m(0) == 2).all()


@pytest.mark.parametrize(
    "style",
    ["seq-01/frame-{0}.{1}.png", "{0}-{1}.png", "a/{0}_{1}.png", "{1}_{0}.png", "a/{1}/{0}.png"],
)
def test_images_and_depth_in_one_folder(tmp_path: Path, style: str) -> None:
    """7-Scenes and 3DMatch; RGB-D Scenes."""
    for number in ("000000", "000001"):
        _image(tmp_path, style.format(number, "color"))
        _depth(tmp_path, style.format(number, "depth"), units=65535)
    listed = _listed(tmp_path)
    assert len(listed) == 2
    for image, depth in listed.values():
        assert image.replace("color", "depth") == depth
    with pytest.raises(DatasetError):  # 65535 is no depth
        open_paired_folder(tmp_path)


def test_kitti_as_it_is_distributed(tmp_path: Path) -> None:
    drive = "2011_09_26_drive_0002_sync"
    _depth(tmp_path, f"val/{drive}/proj_depth/groundtruth/image_02/0000000005.png", units=2560)
    _image(tmp_path, *(f"{drive}/image_02/data/{i:010d}.png" for i in (4, 5, 6)))
    dataset = open_paired_folder(tmp_path)
    assert dataset.ids == (f"{drive}/image_02/0000000005",)
    assert (dataset.depth_m(0) == 10).all()
    selection = tmp_path / "depth_selection/val_selection_cropped"
    name = f"{drive}_{{}}_0000000008_image_03.png"
    _image(selection, f"image/{name.format('image')}")
    _depth(selection, f"groundtruth_depth/{name.format('groundtruth_depth')}", units=2560)
    (selection / "intrinsics").mkdir()
    text = "7.2e+01 0.0 4 0.0 7.2e+01 3 0.0 0.0 1.0"
    (selection / f"intrinsics/{name.format('image')[:-4]}.txt").write_text(text)
    dataset = open_paired_folder(selection)
    assert (dataset.depth_m(0) == 10).all()
    assert dataset.focal_px == (72.0,)


def test_patterns_name_the_files_of_any_layout(tmp_path: Path) -> None:
    _image(tmp_path, "a/left/1.png", "a/left/2.png", "b/left/1.png")
    _depth(tmp_path, "a/gt/1_d.png", "b/gt/1_d.png")
    patterns = ("*/left/*.png", "*/gt/*_d.png")
    assert _listed(tmp_path, patterns=patterns) == {
        "a/1": ("a/left/1.png", "a/gt/1_d.png"),
        "b/1": ("b/left/1.png", "b/gt/1_d.png"),
    }
    assert list_pairs(tmp_path, patterns).left_out == 1
    trained = open_training_data(tmp_path, paired=False, patterns=patterns).dataset
    assert trained.ids == ("a/1", "b/1")
    with pytest.raises(UsageError):
        list_pairs(tmp_path, ("left.png", "gt.png"))
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path, patterns=("*.jpg", "*.exr"))
    with pytest.raises(DatasetError):
        list_pairs(tmp_path)


def test_folders_of_ultralytics_hold_out_their_validation_part(tmp_path: Path) -> None:
    """16-bit PNG in millimetres or NPY in metres: docs.ultralytics.com/datasets/depth."""
    parts = ("train/a", "train/b", "val/c", "test/d")
    _image(tmp_path, *(f"images/{name}.jpg" for name in parts))
    _depth(tmp_path, *(f"depth/{name}.png" for name in parts[:3]))
    (tmp_path / "depth" / "test").mkdir()
    np.save(tmp_path / "depth" / "test" / "d.npy", np.full((6, 8), 3, np.float32))
    data = open_training_data(tmp_path, paired=True).dataset
    assert [float(data.depth_m(i)[0, 0]) for i in range(4)] == [3, 2, 2, 2]
    train, held_out = train_val_split(data, DataConfig())
    assert [data.ids[i] for i in train] == ["train/a", "train/b"]
    assert [data.ids[i] for i in held_out] == ["val/c"]
