"""Training data and layouts of data sets as they are distributed."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from helpers import made
from helpers.tiny import write_image

from depthcli.core.camera import Intrinsics
from depthcli.core.types import Frame
from depthcli.errors import DatasetError, UsageError
from depthcli.inference.transforms import input_layout, intrinsics_of, metric_scale
from depthcli.io.images.pixels import upright
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.lab.datasets.base import Pair, SplitName, split_nyu
from depthcli.lab.datasets.folders import in_view, open_paired_folder
from depthcli.lab.datasets.layouts import list_pairs
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.datasets.training_data import open_training_data
from depthcli.lab.training.config import DataConfig
from depthcli.lab.training.provenance import train_val_split
from depthcli.models.card import CameraSpec
from depthcli.models.catalog import find_model

ROOT = Path(__file__).parents[3]


def _image(root: Path, *names: str, size: tuple[int, int] = (6, 8)) -> None:
    for name in names:
        write_image(root / name, np.full((*size, 3), 9, np.uint8))


def _depth(root: Path, *names: str, units: int = 2000, size: tuple[int, int] = (6, 8)) -> None:
    for name in names:
        write_image(root / name, np.full(size, units, np.uint16))


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
    view_m = in_view(depth_m, pair, (8, 16))
    for y in range(8):
        for x in range(16):
            column, row = (x - 7.5) / 2 + 7.5, (y - 3.5) / 2 + 3.5
            assert abs(view_m[y, x] % 16 - column) <= 0.5
            assert abs(view_m[y, x] // 16 - row) <= 0.5


@pytest.mark.parametrize("size", [(12, 16), (16, 16)])
def test_depth_of_the_sensor_is_turned_with_its_image(
    size: tuple[int, int], tmp_path: Path
) -> None:
    depth_mm = np.arange(1000, 1000 + size[0] * size[1], dtype=np.uint16).reshape(size)
    write_image(tmp_path / "depth/a.png", depth_mm)
    image = write_image(tmp_path / "rgb/a.jpg", np.full((*size, 3), 99, np.uint8))
    image.write_bytes(made.jpeg_with_exif(image.read_bytes(), made.exif(6)))
    dataset, is_square = open_paired_folder(tmp_path), size == (16, 16)
    expected = depth_mm if is_square else upright(depth_mm, 6)
    np.testing.assert_allclose(dataset.depth_m(0), expected / 1000)
    assert is_square == any("orientation 6" in warning for warning in dataset.warnings)


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


def test_a_pattern_without_a_slash_fits_in_any_folder_and_masks_apply(tmp_path: Path) -> None:
    """As that of ``batch --include``; SysCV/idisc#9: DIODE has masks beside its depth."""
    _image(tmp_path, "deep/a/1.png", "0.png")
    for name in ("deep/a/1", "0"):
        np.save(tmp_path / f"{name}_depth.npy", np.full((6, 8, 1), 2, np.float32))
    np.save(tmp_path / "deep/a/1_depth_mask.npy", np.arange(48.0).reshape(6, 8) % 2)
    dataset = open_paired_folder(tmp_path, patterns=("*.png", "*_depth.npy"))
    assert dataset.ids == ("0", "deep/a/1")
    assert dataset.depth_m(1).tolist() == [[0, 2] * 4] * 6
    assert (dataset.depth_m(0) == 2).all()
    assert any("1 file" in note and "_mask" in note for note in dataset.notes)
    assert len(dataset.files(1)) == 3
    np.save(tmp_path / "deep/a/1_depth_mask.npy", np.ones((3, 8), np.float32))
    with pytest.raises(DatasetError):
        dataset.depth_m(1)


def test_a_folder_is_named_from_within_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """7-Scenes, mohankumarpaluru/oracle-freetier-instance-creation#49: ``eval pairs .``."""
    _image(tmp_path, "frame-0.color.png")
    _depth(tmp_path, "frame-0.depth.png")
    monkeypatch.chdir(tmp_path)
    for paired in (True, False):
        assert open_training_data(Path(), paired=paired).dataset.ids == ("frame-0",)


def test_a_list_names_image_depth_and_focal_length(tmp_path: Path) -> None:
    """shariqfarooq123/AdaBins#73: the lists of BTS, with a slash first in some, None in others."""
    _image(tmp_path, "hall/rgb_1.jpg", "yard/rgb_1.jpg")
    _depth(tmp_path, "hall/sync_1.png", "yard/sync_1.png")
    table, rows = tmp_path / "list.txt", ["/hall/rgb_1.jpg /hall/sync_1.png 518.8"]
    table.write_text(
        "\n".join([*rows, "yard/rgb_1.jpg None 9", "yard/rgb_1.jpg yard/sync_1.png 9"])
    )
    dataset = open_paired_folder(table)
    assert (dataset.ids, dataset.scenes) == (("hall/rgb_1", "yard/rgb_1"), ("hall", "yard"))
    assert dataset.focal_px == (518.8, 9.0)
    assert len(open_training_data(table, paired=True).dataset) == 2
    for line, reason in (("a.jpg", "FOCAL_PX"), ("a.jpg b.png x", "x"), (f"{rows[0]}1", "twice")):
        table.write_text("\n".join([*rows, line]))
        with pytest.raises(DatasetError, match=reason):
            open_paired_folder(table)


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


def _fill(folder: Path, images: list[str], depths: list[str]) -> Path:
    for kind, names in (("rgb", images), ("depth", depths)):
        for number, name in enumerate(names):
            image = np.full((6, 8, 3), number, np.uint8)
            depth = np.full((4, 4) if name[0] == "z" else (6, 8), 1000 + number, np.uint16)
            write_image(folder / kind / f"{name}.png", image if kind == "rgb" else depth)
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


def test_images_and_depth_of_cyclegan_are_two_lists(tmp_path: Path) -> None:
    """junyanz/pytorch-CycleGAN-and-pix2pix#120: ``trainA`` and ``trainB``, also by patterns."""
    _image(tmp_path, "trainA/a.png", "trainA/b.png")
    _depth(tmp_path, "trainB/d.png", size=(4, 4))
    for patterns in (None, ("trainA/*", "trainB/*")):
        dataset = open_training_data(tmp_path, paired=False, patterns=patterns).dataset
        assert (len(dataset), dataset.paired) == (2, False)


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


def test_a_model_that_learns_pairs_of_any_camera_gives_their_metres(tmp_path: Path) -> None:
    """What it is taught, multiplied as its predictions are, is the depth of the files."""
    card, random = find_model(ROOT / "models/default").card, np.random.default_rng(0)
    card = replace(card, camera=CameraSpec(63.3))
    names = ("a.png", "b.png", "c.png")
    _image(tmp_path / "rgb", *names, size=(24, 32))
    for name in names:
        depth = random.integers(500, 9000, (24, 32)).astype(np.uint16)
        write_image(tmp_path / "depth" / name, depth)
    (tmp_path / "cameras.csv").write_text("id,focal_px\na,15\nb,26\nc,60\n")
    data, truth = open_training_data(tmp_path, paired=True), open_paired_folder(tmp_path)
    assert data.hfov_deg == card.camera.hfov_deg
    for i in range(len(truth)):
        frame = Frame(truth.image(i))
        camera = intrinsics_of(card, frame, Intrinsics(truth.focal_px[i]))
        scale = metric_scale(card, frame, input_layout(card.input, 32, 24), camera)
        np.testing.assert_allclose(data.dataset.depth_m(i) * scale, truth.depth_m(i), rtol=2e-3)
    extra = open_training_data(tmp_path, paired=True).with_pseudo_labels(truth).pseudo_labels
    np.testing.assert_array_equal(extra.depth_m(1), data.dataset.depth_m(1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,focal_px\na,30\n", "has no focal_px of 'b'"),
        ("id,mm\na,30\nb,30\n", "has no columns id,focal_px"),
        ("id,hfov_deg\na,30\nb,30\n", "has no focal_px of 'a'"),
        ("id,focal_px\na,30\nb,long\n", "line 3: focal_px is a number .*, not 'long'"),
        ("id,focal_px\na,30\nb,nan\n", "focal_px is a number from 0.001 to 1e8"),
        ("id,focal_px\na,30\nb,1e300\n", "focal_px is a number from 0.001 to 1e8"),
    ],
)
def test_incomplete_cameras_csv_is_refused(tmp_path: Path, text: str, message: str) -> None:
    _fill(tmp_path, ["a", "b"], ["a", "b"])
    assert open_paired_folder(tmp_path).focal_px == ()
    (tmp_path / "cameras.csv").write_text("\ufeffid,focal_px\na,30\nb,40\n")  # as Excel writes it
    assert open_paired_folder(tmp_path).focal_px == (30, 40)
    (tmp_path / "cameras.csv").write_text(text)
    with pytest.raises(DatasetError, match=message):
        open_paired_folder(tmp_path)
