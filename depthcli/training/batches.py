"""Batches of network inputs and metric depth, from pictures held in memory.

Every batch is a function of (seed, step) alone, so a resumed run sees what an unbroken one sees.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import torch

from depthcli.errors import DatasetError, UsageError
from depthcli.training.augment import augment, network_input
from depthcli.training.holes import shrink

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor

    from depthcli.datasets.base import DepthDataset
    from depthcli.training.augment import Views
    from depthcli.training.config import DataConfig

_STORED_PER_NETWORK_PX = 2  # twice the network's size leaves detail for zooming in


class Batch(NamedTuple):
    """What one training step is shown.

    Attributes:
        gray: (B, 1, H, W) float32 in [-1, 1].
        depth_m: (B, 1, H, W) float32 metres, holes filled; of the same scenes, or of others if
            unpaired.
        known: (B, 1, H, W) bool, False in the holes; None if there are none.
    """

    gray: Tensor
    depth_m: Tensor
    known: Tensor | None = None


class PairStore:
    """Some pairs of a data set, shrunk once and kept in memory.

    Args:
        dataset: where they are read.
        positions: which pairs.
        data: gives the network's size.

    Attributes:
        rgb: (N, 3, h, w) uint8.
        depth_m: (N, 1, h, w) float16 metres, exact to 5 mm below 10 m; holes are filled.
        known: (N, 1, h, w) bool, False in the holes; None if no pair has one.

    Raises:
        DatasetError: there is no pair, or one without depth.
    """

    def __init__(self, dataset: DepthDataset, positions: Sequence[int], data: DataConfig) -> None:
        if not positions:
            raise DatasetError("no pair to train on: check the data folder and holdout_every")
        size = (data.width * _STORED_PER_NETWORK_PX, data.height * _STORED_PER_NETWORK_PX)
        shape = (len(positions), 3, size[1], size[0])
        self.rgb = torch.empty(shape, dtype=torch.uint8)
        self.depth_m = torch.empty((len(positions), 1, *shape[2:]), dtype=torch.float16)
        self.known: Tensor | None = None
        for row, position in enumerate(positions):
            rgb = cv2.resize(dataset.image(position), size, interpolation=cv2.INTER_AREA)
            self.rgb[row] = torch.from_numpy(rgb).permute(2, 0, 1)
            measured = shrink(dataset.depth_m(position), size)
            if measured is None:
                raise DatasetError(
                    f"pair {dataset.ids[position]} has almost no depth: leave it out or repair it"
                )
            self.depth_m[row, 0] = torch.from_numpy(measured.depth_m)
            if measured.known is not None:
                self._note_holes(row, torch.from_numpy(measured.known))

    def __len__(self) -> int:
        return len(self.rgb)

    def _note_holes(self, row: int, known: Tensor) -> None:
        if self.known is None:
            self.known = torch.ones(self.depth_m.shape, dtype=torch.bool)
        self.known[row, 0] = known


class Batches:
    """The batches of a run, by step.

    Args:
        store: the training pairs.
        data: size, pairing and augmentation.
        batch_size: pairs a batch, of all processes together; the last incomplete batch of an
            epoch is dropped.
        seed: of order and augmentation.
        device: where the batch is moved before it is augmented.
        process: which of the processes this is, from 0; each gets its own part of every batch.
        processes: how many there are.

    Raises:
        UsageError: the batch cannot be shared out.
    """

    def __init__(
        self,
        store: PairStore,
        data: DataConfig,
        batch_size: int,
        seed: int,
        device: torch.device,
        process: int = 0,
        processes: int = 1,
    ) -> None:
        self.store, self.data, self.seed, self.device = store, data, seed, device
        if batch_size % processes or len(store) < processes:
            raise UsageError(
                f"optim.batch_size={batch_size} of {len(store)} pairs is shared by {processes} "
                f"devices: set it to a multiple of {processes}"
            )
        self.batch_size = min(batch_size, len(store) // processes * processes)
        self.steps_per_epoch = len(store) // self.batch_size
        self.own_size = self.batch_size // processes
        self._own = slice(process * self.own_size, (process + 1) * self.own_size)

    def __getitem__(self, step: int) -> Batch:
        """Batch of a step, counted from 0 over the whole run."""
        epoch, index = divmod(step, self.steps_per_epoch)
        random = torch.Generator().manual_seed(_mixed(self.seed, step, 1))
        rows = self._rows(epoch, index, stream=2)
        views = self._augmented(rows, random)
        if self.data.paired:
            return self._part(Batch(*views))
        others = self._augmented(self._rows(epoch, index, stream=3), random)
        return self._part(Batch(views.gray, others.depth_m, others.known))

    def _part(self, whole: Batch) -> Batch:
        """What this process sees of the batch that a single one would see."""
        known = None if whole.known is None else whole.known[self._own]
        return Batch(whole.gray[self._own], whole.depth_m[self._own], known)

    def _rows(self, epoch: int, index: int, stream: int) -> Tensor:
        random = torch.Generator().manual_seed(_mixed(self.seed, epoch, stream))
        order = torch.randperm(len(self.store), generator=random)
        return order[index * self.batch_size : (index + 1) * self.batch_size]

    def _augmented(self, rows: Tensor, random: torch.Generator) -> Views:
        rgb = self.store.rgb.index_select(0, rows).to(self.device).float().div_(255)
        depth_m = self.store.depth_m.index_select(0, rows).to(self.device).float()
        known = self.store.known
        known = None if known is None else known[rows].to(self.device)
        return augment(rgb, depth_m, self.data, random, known)


def whole_pictures(store: PairStore, data: DataConfig, rows: Tensor) -> Tensor:
    """Network inputs (B, 1, H, W) in [-1, 1] of stored pairs, without augmentation."""
    rgb = store.rgb[rows].float() / 255
    size = (data.height, data.width)
    gray = network_input(rgb, data)  # before resampling, as at inference
    return torch.nn.functional.interpolate(gray, size=size, mode="area")


def _mixed(seed: int, count: int, stream: int) -> int:
    return int(np.random.SeedSequence((seed, count, stream)).generate_state(1, np.uint64)[0] >> 1)
