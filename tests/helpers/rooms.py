"""Tiny synthetic rooms with depth, in memory and on disk, and small runs over them."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch

from depthcli.lab.datasets.training_data import TrainingData
from depthcli.lab.training.config import (
    DataConfig,
    GeneratorConfig,
    LossConfig,
    OptimConfig,
    OutputConfig,
    TrainConfig,
)
from depthcli.lab.training.data import Batches, PairStore
from helpers.in_memory import InMemory
from helpers.tiny import write_image

HEIGHT, WIDTH = 48, 64
SCENES = ("bath_1", "bath_1", "den_1", "hall_1", "hall_1", "office_1")
"""With every fourth scene from the second on held out, position 2 validates and five train."""
TRAIN, HELD_OUT = [0, 1, 3, 4, 5], [2]


@dataclass(frozen=True)
class Rooms(InMemory):
    """A data set in memory: the farther, the darker."""

    images: npt.NDArray[np.uint8]
    depths_m: npt.NDArray[np.float32]
    scenes: tuple[str, ...] = SCENES
    focal_px: tuple[float, ...] = ()
    hfov_deg: float | None = None
    scales: tuple[float, ...] = ()

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(f"{i:04d}" for i in range(len(self.scenes)))

    @property
    def official_split(self) -> tuple[str, ...]:
        return ("train",) * len(self.scenes)

    def __len__(self) -> int:
        return len(self.scenes)

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        return self.images[i]

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        return self.depths_m[i]


def rooms() -> Rooms:
    """Six rooms with tilted walls and a box, depth between 1 and 6 m in whole millimetres."""
    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    images, depths_m = [], []
    for _ in SCENES:
        tilt = rng.uniform(-0.02, 0.02, 2)
        depth_m = 4 + tilt[0] * (columns - WIDTH / 2) + tilt[1] * (rows - HEIGHT / 2)
        top, left = rng.integers(4, 20, 2)
        depth_m[top : top + 20, left : left + 25] = rng.uniform(1, 2)
        depth_m = np.round(depth_m, 3)
        light = 255 * (1 - depth_m / 8)
        pixels = light[..., None] * rng.uniform(0.7, 1, 3) + rng.normal(0, 3, (HEIGHT, WIDTH, 3))
        images.append(pixels.clip(0, 255).astype(np.uint8))
        depths_m.append(depth_m.astype(np.float32))
    return Rooms(np.stack(images), np.stack(depths_m))


def large_rooms() -> Rooms:
    """The six rooms at the size of NYU Depth v2, 640×480 pixels."""
    small = rooms()
    images = [cv2.resize(image, (640, 480)) for image in small.images]
    depths_m = [cv2.resize(depth_m, (640, 480)) for depth_m in small.depths_m]
    return Rooms(np.stack(images), np.stack(depths_m))


def room_data() -> TrainingData:
    """The six rooms as what a run learns from."""
    return TrainingData(rooms(), "six rooms", None)


def write_rooms(folder: Path, dataset: Rooms | None = None, prefix: str = "") -> Path:
    """rgb/ID.png, depth/ID.png in millimetres, index.csv; IDs begin with the prefix."""
    dataset = dataset or rooms()
    lines = ["id,scene,official_split"]
    for i, row in enumerate(zip(dataset.ids, dataset.scenes, dataset.official_split, strict=True)):
        lines.append(prefix + ",".join(row))
        write_image(folder / "rgb" / f"{prefix}{row[0]}.png", dataset.image(i))
        millimetres = np.round(dataset.depth_m(i) * 1000).astype(np.uint16)
        write_image(folder / "depth" / f"{prefix}{row[0]}.png", millimetres)
    (folder / "index.csv").write_text("\n".join([*lines, ""]))
    return folder


PAPER = TrainConfig(
    seed=3,
    generator=GeneratorConfig(width=8, blocks=2),
    data=DataConfig(width=32, height=32, holdout_every=4, holdout_offset=1),
    optim=OptimConfig(epochs_constant=1, epochs_decay=1, pool_size=2, width_discriminator=4),
)
"""Every loss of eq. 7, in small: ten steps in two epochs."""

EFFICIENT = replace(
    PAPER,
    generator=GeneratorConfig(
        name="efficient",
        encoder=(8, 8, 8, 8, 8),  # torch 2.13 corrupts memory with widths below 8
        decoder=(8, 8, 8, 8),
        depths=(1, 1, 1, 1),
        dropout=0.2,
    ),
    output=OutputConfig(coding="log"),
    data=replace(PAPER.data, width=64, zoom=1.5, rotate_deg=5, gamma=0.2, noise=0.03),
    loss=LossConfig(0, 0, 0, 0, 0, l1=1, weight_penalty=0, gradient=2),
    optim=OptimConfig(
        batch_size=2,
        epochs_constant=0,
        epochs_decay=3,
        schedule="cosine",
        warmup_steps=2,
        weight_decay=0.05,
        clip_norm=1,
        ema=0.9,
        pool_size=0,
    ),
)
"""The shipped recipe, in small: six steps in three epochs."""


def batches_of(
    store: PairStore,
    data: DataConfig,
    size: int,
    seed: int = 0,
    pseudo_labels: PairStore | None = None,
) -> Batches:
    """Batches of stored pairs on the CPU."""
    config = TrainConfig(seed=seed, data=data, optim=OptimConfig(batch_size=size))
    return Batches(store, config, torch.device("cpu"), pseudo_labels)
