"""Pairs in memory, downsampled, known depth drawn from them, and batches of both.

A batch depends on (seed, step) only, so a resumed run gets the same ones as an unbroken one.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import cv2
import numpy as np
import torch
from torch import Tensor

from depthcli.core.camera import focal_px_of_hfov
from depthcli.core.imageops import filled_nearest
from depthcli.core.parallel import ordered_map, usable_cores
from depthcli.core.types import BoolArray, Float32Array, UInt8Array
from depthcli.errors import DatasetError, UsageError
from depthcli.lab.datasets.base import DepthDataset
from depthcli.lab.datasets.prompts import WHOLE, Pattern, Prompt
from depthcli.lab.datasets.training_data import NYU_ASPECT, NYU_HFOV_DEG
from depthcli.lab.training.augment import Views, augment, to_network_input, view_size
from depthcli.lab.training.config import DataConfig, PromptConfig, TrainConfig

# One half, less a margin for rounding.
_LEAST_SHARE = 0.5 - 1e-5
_STORED_PER_NETWORK_PX = 2  # twice the network's size leaves detail for zooming in
_MEMORY_SHARE = 0.5  # of a GPU's free memory that pairs may take; networks need the rest
_NOISY = 0.5  # share of prompts with noise, of those with errors
_PART_SIDES = 0.25, 0.8  # of the part of an image that has points


def downsample(
    depth_m: Float32Array, size: tuple[int, int]
) -> tuple[Float32Array, BoolArray | None] | None:
    """Downsample depth to a width and height; the mean of what was measured in each new pixel.

    Depth is (H, W) float32 metres, with 0, NaN or infinity in holes. A new pixel is valid if half
    of its area was measured; the others get the depth of the nearest valid one. Returns metres and
    mask (h, w), without a mask if all pixels are valid, and None if no pixel is.
    """

    def area(values: Float32Array) -> Float32Array:
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)

    valid_mask = np.isfinite(depth_m) & (depth_m > 0)
    if valid_mask.all():
        return area(depth_m), None
    share = area(valid_mask.astype(np.float32))
    total_m = area(np.where(valid_mask, depth_m, np.float32(0)))
    measured = share >= _LEAST_SHARE
    if not measured.any():
        return None
    mean_m = np.divide(total_m, share, out=total_m, where=measured)
    return filled_nearest(mean_m, measured), None if measured.all() else measured


def tan_half_fov(dataset: DepthDataset, i: int, shape: tuple[int, ...]) -> tuple[float, float]:
    """Tangents of half the angles of view of image ``i``, across and down, for square pixels.

    An unknown camera is that of the largest crop of one of NYU's images, in landscape or portrait,
    as in predictions (docs/cameras.md). ``shape`` begins with height and width, of image or depth.
    """
    height, width = shape[:2]
    long_px = max(width, height, NYU_ASPECT * min(width, height))
    focal_px = long_px * focal_px_of_hfov(NYU_HFOV_DEG, 1)
    if dataset.focal_px:
        focal_px = dataset.focal_px[i]
    elif dataset.hfov_deg is not None:
        focal_px = focal_px_of_hfov(dataset.hfov_deg, width)
    return width / 2 / focal_px, height / 2 / focal_px


_Pair = tuple[UInt8Array, Float32Array, BoolArray | None, list[tuple[float, float]]]


class PairStore:
    """Pairs of a data set, downsampled once and kept in memory.

    Attributes:
        rgb: (N, 3, h, w) uint8.
        depth_m: (N, 1, h, w) float16 metres, exact to 5 mm below 10 m; holes are filled.
        valid_mask: (N, 1, h, w) bool, False in the holes; None if no pair has one.
        tan_half_fov: (N, 2, 2) float64, of each image and of its depth, which differ only in
            unpaired data: the tangent of half the angle of view, across and down.
    """

    def __init__(self, dataset: DepthDataset, positions: Sequence[int], data: DataConfig) -> None:
        if not positions:
            advice = "check the data folder, data.holdout_every and data.holdout_offset"
            raise DatasetError("no pair to train on", advice)
        size = _stored_size(dataset.image(positions[0]).shape, data)
        shape = (len(positions), 3, size[1], size[0])
        self.rgb = torch.empty(shape, dtype=torch.uint8)
        self.depth_m = torch.empty((len(positions), 1, *shape[2:]), dtype=torch.float16)
        self.valid_mask: Tensor | None = None
        self.tan_half_fov = torch.empty((len(positions), 2, 2), dtype=torch.float64)
        pairs = ordered_map(
            lambda position: self._pair(dataset, position, size), positions, workers=usable_cores()
        )
        for row, (rgb, depth_m, measured, halves) in enumerate(pairs):
            self.tan_half_fov[row] = torch.tensor(halves, dtype=torch.float64)
            self.rgb[row] = torch.from_numpy(rgb).permute(2, 0, 1)
            self.depth_m[row, 0] = torch.from_numpy(depth_m)
            if measured is not None:
                if self.valid_mask is None:
                    self.valid_mask = torch.ones(self.depth_m.shape, dtype=torch.bool)
                self.valid_mask[row, 0] = torch.from_numpy(measured)

    @staticmethod
    def _pair(dataset: DepthDataset, position: int, size: tuple[int, int]) -> _Pair:
        image, depth_m = dataset.image(position), dataset.depth_m(position)
        filled = downsample(depth_m, size)
        if filled is None:
            raise DatasetError(
                f"pair {dataset.ids[position]} has almost no depth", "remove or repair it"
            )
        halves = [tan_half_fov(dataset, position, pixels.shape) for pixels in (image, depth_m)]
        rgb = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        return rgb, *filled, halves

    def to(self, device: torch.device) -> Self:
        """Move the pairs to a GPU whose free memory is at least twice their size."""
        names = ("rgb", "depth_m", *(["valid_mask"] if self.valid_mask is not None else []))
        size = sum(getattr(self, name).nbytes for name in names)
        if device.type == "cuda" and _MEMORY_SHARE * torch.cuda.mem_get_info(device)[0] > size:
            for name in names:
                setattr(self, name, getattr(self, name).to(device))
        return self

    def __len__(self) -> int:
        return len(self.rgb)


def _stored_size(shape: tuple[int, ...], data: DataConfig) -> tuple[int, int]:
    """Width and height in memory: up to twice the network's size, at most about the image's."""
    most = min(_STORED_PER_NETWORK_PX, max(1.0, shape[1] / data.width, shape[0] / data.height))
    return round(data.width * most), round(data.height * most)


def whole_images(store: PairStore, data: DataConfig, rows: Tensor) -> Tensor:
    """Network inputs (B, 1, H, W) in [-1, 1] of stored pairs (B,) int64, without augmentation."""
    gray = to_network_input(store.rgb[rows].float() / 255, data)  # then resampled, as at inference
    return torch.nn.functional.interpolate(gray, size=(data.height, data.width), mode="area")


def drawn_prompts(views: Views, config: PromptConfig, seed: np.random.SeedSequence) -> Tensor:
    """Known depth of each view, (B, 1, H, W) metres, 0 where nothing is known."""
    random = np.random.default_rng(seed)
    depth_m = views.depth_m if views.valid_mask is None else views.depth_m * views.valid_mask
    maps = (values.float().mean(1).cpu().numpy() for values in (depth_m, views.network_input))
    drawn = [
        drawn_prompt(config, random).draw(map_m, gray, random)
        for map_m, gray in zip(*maps, strict=True)
    ]
    return torch.from_numpy(np.stack(drawn))[:, None].to(depth_m.device)


def drawn_prompt(config: PromptConfig, random: np.random.Generator) -> Prompt:
    """A pattern of known depth with its errors."""
    pattern = Pattern(config.patterns[random.integers(len(config.patterns))])
    if pattern is Pattern.LIDAR:
        size = config.lines[random.integers(len(config.lines))]
    else:
        least, most = {
            Pattern.UNIFORM: config.points,
            Pattern.CORNERS: config.corners,
            Pattern.CAMERA: config.columns,
        }[pattern]
        size = round(_between(least, most, random))
    range_m, part = _between(*config.range_m, random), WHOLE
    if random.random() < config.missing:
        width, height = random.uniform(*_PART_SIDES, 2)
        left, top = random.random(2) * (1 - width, 1 - height)
        part = left, top, left + width, top + height
    if random.random() < config.exact:
        return Prompt(pattern, size, jitter_px=config.jitter_px, part=part, range_m=range_m)
    is_shifted = random.random() < config.shifted
    shift_px = random.uniform(-config.shift_px, config.shift_px, 2) * is_shifted
    return Prompt(
        pattern,
        size,
        noise=random.uniform(0, config.noise) * (random.random() < _NOISY),
        has_kinect_noise=random.random() < config.kinect,
        wrong=config.wrong[random.integers(len(config.wrong))],
        shift_px=(float(shift_px[0]), float(shift_px[1])),
        jitter_px=config.jitter_px,
        part=part,
        range_m=range_m,
    )


def _between(least: float, most: float, random: np.random.Generator) -> float:
    """A number between two, whose logarithm is uniform."""
    return math.exp(random.uniform(math.log(least), math.log(most)))


class TrainingBatch(NamedTuple):
    """The input of one training step."""

    network_input: Tensor  #: (B, 1, H, W) float32 in [-1, 1]
    depth_m: Tensor  #: (B, 1, H, W) float32 metres, holes filled; of other scenes if unpaired
    valid_mask: Tensor | None = None  #: (B, 1, H, W) bool, False in the holes; None without
    is_pseudo_label: Tensor | None = None  #: (B,) bool; None if there are no pseudo labels
    prompt_m: Tensor | None = None  #: (B, 1, H, W) float32 metres of known depth, 0 elsewhere

    def parts(self, count: int) -> list["TrainingBatch"]:
        """Up to ``count`` batches of neighbouring images, of about equal numbers."""
        columns = ([None] * count if part is None else part.chunk(count) for part in self)
        return [TrainingBatch(*rows) for rows in zip(*columns, strict=False)]


class Batches:
    """The batches of a run, by step, augmented on its device.

    An epoch is a pass through ``store`` without an incomplete last batch. Of each batch,
    ``data.pseudo_label_share`` are pseudo labels, if there are any.
    """

    def __init__(
        self,
        store: PairStore,
        config: TrainConfig,
        device: torch.device,
        pseudo_labels: PairStore | None = None,
    ) -> None:
        data, batch_size = config.data, config.optim.batch_size
        self.store, self.data, self.seed, self.device = store, data, config.seed, device
        self.prompts = config.prompt if config.generator.prompt else None
        self.pseudo_labels = pseudo_labels
        count = round(batch_size * data.pseudo_label_share) if pseudo_labels else 0
        if pseudo_labels and not 0 < count < min(batch_size, len(pseudo_labels) + 1):
            share, have = data.pseudo_label_share, len(pseudo_labels)
            message = f"data.pseudo_label_share={share} is {count} of {batch_size} pairs of a batch"
            raise UsageError(message, f"it has to be at least 1, and leave pairs; there are {have}")
        self._pseudo_label_count = count
        self.batch_size = min(batch_size - count, len(store))
        self.steps_per_epoch = len(store) // self.batch_size

    def __getitem__(self, step: int) -> TrainingBatch:
        """Batch of a step, counted from 0 over the whole run."""
        random = torch.Generator().manual_seed(_stream_seed(self.seed, step, 1))
        size = view_size(self.data, random)
        rows = self._rows(self.store, step, self.batch_size, stream=2)
        views = self._augmented(self.store, rows, size, random)
        if not self.data.paired:
            rows = self._rows(self.store, step, self.batch_size, stream=3)
            others = self._augmented(self.store, rows, size, random, part=1)
            views = Views(views.network_input, others.depth_m, others.valid_mask)
        if self.prompts is not None:
            drawn = drawn_prompts(views, self.prompts, _stream(self.seed, step, 5))
            return TrainingBatch(*views, prompt_m=drawn)
        if self.pseudo_labels is None:
            return TrainingBatch(*views)
        rows = self._rows(self.pseudo_labels, step, self._pseudo_label_count, stream=4)
        return _concatenated(views, self._augmented(self.pseudo_labels, rows, size, random))

    def _rows(self, store: PairStore, step: int, size: int, stream: int) -> Tensor:
        """Rows (``size``,) int64 of a step; the store is shuffled anew for each epoch."""
        epoch, index = divmod(step, len(store) // size)
        random = torch.Generator().manual_seed(_stream_seed(self.seed, epoch, stream))
        order = torch.randperm(len(store), generator=random)
        return order[index * size : (index + 1) * size]

    def _augmented(
        self,
        store: PairStore,
        rows: Tensor,
        size: tuple[int, int],
        random: torch.Generator,
        part: int = 0,
    ) -> Views:
        """Views with the geometry of the images (``part`` 0) or of the depth (1)."""
        halves = store.tan_half_fov[rows, part]
        rows = rows.to(store.rgb.device)
        rgb = store.rgb.index_select(0, rows).to(self.device).float().div_(255)
        depth_m = store.depth_m.index_select(0, rows).to(self.device).float()
        valid_mask = None if store.valid_mask is None else store.valid_mask[rows].to(self.device)
        return augment(rgb, depth_m, self.data, random, valid_mask, size, halves)


def _concatenated(views: Views, labels: Views) -> TrainingBatch:
    parts = (views, labels)
    is_whole = views.valid_mask is None and labels.valid_mask is None
    masks = [
        torch.ones_like(part.depth_m) > 0 if part.valid_mask is None else part.valid_mask
        for part in parts
    ]
    depth_m = torch.cat([part.depth_m for part in parts])
    is_pseudo_label = torch.arange(len(depth_m), device=depth_m.device) >= len(views.depth_m)
    images = torch.cat([part.network_input for part in parts])
    return TrainingBatch(images, depth_m, None if is_whole else torch.cat(masks), is_pseudo_label)


def _stream_seed(seed: int, count: int, stream: int) -> int:
    return int(_stream(seed, count, stream).generate_state(1, np.uint64)[0] >> 1)


def _stream(seed: int, count: int, stream: int) -> np.random.SeedSequence:
    return np.random.SeedSequence((seed, count, stream))
