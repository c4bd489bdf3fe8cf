"""Tiny data sets with the layouts of the real ones."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import pytest
from helpers.tiny import write_image

SCENES = ("kitchen_0004", "kitchen_0004", "office_0003", "bedroom_0010", "study_0002")
PARTS = ("test", "test", "train", "train", "test")
HEIGHT, WIDTH = 12, 16


@dataclass(frozen=True, slots=True)
class Made:
    """A data set on disk and what is in it."""

    path: Path
    images: npt.NDArray[np.uint8]
    depths_m: npt.NDArray[np.float32]
    raw_depths_m: npt.NDArray[np.float32]


def _content() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    rng = np.random.default_rng(3)
    images = rng.integers(0, 256, (len(SCENES), HEIGHT, WIDTH, 3), dtype=np.uint8)
    millimetres = rng.integers(1500, 4500, (len(SCENES), HEIGHT, WIDTH))
    return images, (millimetres / 1000).astype(np.float32)


@pytest.fixture
def nyu_folder(tmp_path: Path) -> Made:
    """rgb/ID.png (lossless, to compare pixels), depth/ID.png, index.csv."""
    images, depths_m = _content()
    lines = ["id,scene,official_split"]
    for i, (scene, part) in enumerate(zip(SCENES, PARTS, strict=True)):
        write_image(tmp_path / "rgb" / f"{i:04d}.png", images[i])
        millimetres = np.round(depths_m[i] * 1000).astype(np.uint16)
        write_image(tmp_path / "depth" / f"{i:04d}.png", millimetres)
        lines.append(f"{i:04d},{scene},{part}")
    (tmp_path / "index.csv").write_text("\n".join(lines))
    return Made(tmp_path, images, depths_m, depths_m)


@pytest.fixture
def nyu_mat(tmp_path: Path) -> Made:
    """The official file in small: all axes reversed, user block, scenes behind references."""
    images, depths_m = _content()
    raw_m = np.where(np.arange(WIDTH) % 2, depths_m, 0).astype(np.float32)
    path = tmp_path / "nyu_depth_v2_labeled.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["images"] = images.transpose(0, 3, 2, 1)
        file["depths"] = depths_m.transpose(0, 2, 1)
        file["rawDepths"] = raw_m.transpose(0, 2, 1)
        references = np.empty((1, len(SCENES)), h5py.ref_dtype)
        for i, scene in enumerate(SCENES):
            codes = np.array([[ord(letter)] for letter in scene], np.uint16)
            references[0, i] = file.create_dataset(f"#refs#/{i}", data=codes).ref
        file.create_dataset("scenes", data=references, dtype=h5py.ref_dtype)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))
    return Made(path, images, depths_m, raw_m)
