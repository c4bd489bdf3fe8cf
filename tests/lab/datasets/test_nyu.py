import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from depthcli.errors import DatasetError
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.datasets.training_data import NYU_PAPER, open_training_data

SCENES = ("kitchen_0004", "kitchen_0004", "office_0003", "bedroom_0010", "study_0002")
PARTS = ("test", "test", "train", "train", "test")
IDS = ("0000", "0001", "0002", "0003", "0004")


@pytest.mark.parametrize("kind", ["nyu_folder", "nyu_mat"])
def test_both_layouts_give_the_same_pairs(kind: str, request: pytest.FixtureRequest) -> None:
    nyu = request.getfixturevalue(kind)
    dataset = open_nyu(nyu.path)
    assert len(dataset) == 5
    assert tuple(dataset.ids) == IDS
    assert tuple(dataset.scenes) == SCENES
    assert tuple(dataset.official_split) == (PARTS if kind == "nyu_folder" else ("",) * 5)
    for i in range(5):
        image, depth_m = dataset.image(i), dataset.depth_m(i)
        assert image.dtype == np.uint8
        assert depth_m.dtype == np.float32
        assert image.flags.c_contiguous
        assert depth_m.flags.c_contiguous
        np.testing.assert_array_equal(image, nyu.images[i])
        np.testing.assert_array_equal(depth_m, nyu.depths_m[i])


def test_index_beside_the_mat_supplies_the_official_split(nyu_mat: Any) -> None:
    lines = ["id,scene,official_split", "0000,kitchen_0004,test", "0002,office_0003,train"]
    nyu_mat.path.with_name("index.csv").write_text("\n".join(lines))
    for path in (nyu_mat.path, nyu_mat.path.parent):
        assert tuple(open_nyu(path).official_split) == ("test", "", "train", "", "")


def test_raw_depth_of_the_mat(nyu_mat: Any) -> None:
    dataset = open_nyu(nyu_mat.path)
    np.testing.assert_array_equal(dataset.raw_depth_m(2), nyu_mat.raw_depths_m[2])


def test_raw_depth_of_a_folder(nyu_folder: Any) -> None:
    dataset = open_nyu(nyu_folder.path)
    with pytest.raises(DatasetError):
        dataset.raw_depth_m(0)
    shutil.copytree(nyu_folder.path / "depth", nyu_folder.path / "raw_depth")
    np.testing.assert_array_equal(dataset.raw_depth_m(0), nyu_folder.depths_m[0])


def _text(name: str, content: str) -> Callable[[Path], object]:
    return lambda root: (root / name).write_text(content)


def _index(change: Callable[[list[str]], list[str]]) -> Callable[[Path], object]:
    """Change the lines of the index."""
    path = Path("index.csv")
    return lambda root: (root / path).write_text(
        "\n".join(change((root / path).read_text().splitlines()))
    )


def _image(name: str, pixels: np.ndarray) -> Callable[[Path], object]:
    return lambda root: cv2.imwrite(str(root / name), pixels)


def _rescale(units_per_metre: float) -> Callable[[Path], None]:
    def apply(root: Path) -> None:
        for path in (root / "depth").iterdir():
            stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) * (units_per_metre / 1000)
            cv2.imwrite(str(path), stored.astype(np.uint16))

    return apply


def _empty(kind: str) -> Callable[[Path], None]:
    def apply(root: Path) -> None:
        for path in (root / kind).iterdir():
            path.unlink()

    return apply


BROKEN: dict[str, Callable[[Path], object]] = {
    "no rgb": lambda root: shutil.rmtree(root / "rgb"),
    "no depth": lambda root: shutil.rmtree(root / "depth"),
    "empty rgb": _empty("rgb"),
    "empty depth": _empty("depth"),
    "lost depth": lambda root: (root / "depth" / "0003.png").unlink(),
    "no index": lambda root: (root / "index.csv").unlink(),
    "short index": _index(lambda lines: lines[:-1]),
    "doubled index": _index(lambda lines: [*lines, lines[-1]]),
    "index without column": _text("index.csv", "id,scene\n0000,a\n"),
    "index with other part": _text("index.csv", "id,scene,official_split\n0000,a,val\n"),
    "8-bit depth": _image("depth/0003.png", np.full((12, 16), 200, np.uint8)),
    "colour depth": _image("depth/0003.png", np.full((12, 16, 3), 2000, np.uint16)),
    "depth is no PNG": _text("depth/0001.png", "not an image at all, really"),
    "metres × 256": _rescale(256),
    "metres × 5000": _rescale(5000),
    "other size": _image("rgb/0000.png", np.zeros((6, 9, 3), np.uint8)),
    "image is no image": _text("rgb/0000.png", "no"),
    "two images of one name": lambda root: shutil.copy(
        root / "rgb" / "0002.png", root / "rgb" / "0002.jpg"
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_folder_is_a_dataset_error_in_one_line(name: str, nyu_folder: Any) -> None:
    BROKEN[name](nyu_folder.path)
    with pytest.raises(DatasetError) as error:
        open_nyu(nyu_folder.path)
    assert "\n" not in str(error.value)


def test_files_that_change_after_opening(nyu_folder: Any) -> None:
    dataset = open_nyu(nyu_folder.path)
    (nyu_folder.path / "rgb" / "0004.png").unlink()
    path = nyu_folder.path / "depth" / "0004.png"
    path.write_bytes(path.read_bytes()[:40])
    for read in (dataset.image, dataset.depth_m):
        with pytest.raises(DatasetError, match=r"0004\.png"):
            read(4)


def test_missing_or_truncated_file(nyu_mat: Any) -> None:
    for data in (b"MATLAB 5.0 MAT-file" * 100, nyu_mat.path.read_bytes()[:3000]):
        nyu_mat.path.write_bytes(data)
        with pytest.raises(DatasetError):
            open_nyu(nyu_mat.path)
    with pytest.raises(DatasetError):
        open_nyu(nyu_mat.path / "nowhere")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *((name, None) for name in ("images", "depths", "scenes")),
        ("depths", lambda depth_m: depth_m * 1000),
        ("depths", lambda depth_m: depth_m + 1j),
        ("depths", lambda depth_m: depth_m[:, :, ::2]),
        ("rawDepths", lambda depth_m: depth_m[1:]),
        ("images", lambda images: images[:, :1]),
    ],
)
def test_mat_without_a_part_or_of_other_values_is_refused(
    name: str, change: Any, nyu_mat: Any
) -> None:
    """Millimetres, complex numbers, and arrays of other sizes were read."""
    with h5py.File(nyu_mat.path, "r+") as file:
        values = file[name][()]
        del file[name]
        if change is not None:
            file[name] = change(values)
    with pytest.raises(DatasetError):
        open_nyu(nyu_mat.path)


def test_without_h5py_the_error_says_what_to_install(
    nyu_mat: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(DatasetError):
        open_nyu(nyu_mat.path)


def test_mat_that_is_damaged_inside(nyu_mat: Any) -> None:
    with h5py.File(nyu_mat.path, "r+") as file:
        depths = file["depths"][()]
        del file["depths"]
        file.create_dataset("depths", data=depths, chunks=(1, 16, 12), compression="gzip")
    dataset = open_nyu(nyu_mat.path)
    with h5py.File(nyu_mat.path, "r") as file:
        chunk = file["depths"].id.get_chunk_info(3)
    with nyu_mat.path.open("r+b") as raw:
        raw.seek(chunk.byte_offset)
        raw.write(b"\0" * chunk.size)
    with pytest.raises(DatasetError, match=r"depths\[3\]"):
        dataset.depth_m(3)


def test_nyu_by_name_is_where_the_environment_says(
    nyu_folder: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DEPTHCLI_NYU", raising=False)
    with pytest.raises(DatasetError, match="520609c519fba3ba5ac58c8fefcc3530"):
        open_nyu(Path("nyu"))
    monkeypatch.setenv("DEPTHCLI_NYU", str(nyu_folder.path))
    assert open_nyu(Path("nyu")).ids == IDS
    assert open_training_data(Path("nyu"), paired=True).title == NYU_PAPER
