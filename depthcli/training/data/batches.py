"""Batches of network inputs and metric depth, from pairs in memory.

A batch depends on (seed, step) only, so a resumed run gets the same ones as an unbroken one.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from depthcli.errors import UsageError
from depthcli.training.config.schema import DataConfig
from depthcli.training.data.augment import Views, augment
from depthcli.training.data.pair_store import PairStore
from depthcli.training.views import view_size


class TrainingBatch(NamedTuple):
    """The input of one training step."""

    network_input: Tensor  #: (B, 1, H, W) float32 in [-1, 1]
    #: (B, 1, H, W) float32 metres, holes filled; of other scenes if unpaired
    depth_m: Tensor
    valid_mask: Tensor | None = (
        None  #: (B, 1, H, W) bool, False in the holes; None if there are none
    )
    #: (B,) bool, True for pseudo labels; None if there are none
    is_pseudo_label: Tensor | None = None


class Batches:
    """The batches of a run, by step.

    Args:
        store: the training pairs.
        data: size, pairing and augmentation.
        batch_size: pairs per batch, of all processes together; the last incomplete batch of an
            epoch is dropped.
        seed: of order and augmentation.
        device: the batch is moved to it before augmentation.
        process: rank of this process; each gets its own part of every batch.
        processes: number of processes.
        pseudo_labels: pairs with less reliable depth, ``data.pseudo_label_share`` of each batch; an
            epoch is a pass through ``store``.

    Raises:
        UsageError: the batch cannot be divided among the processes or between both stores.
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
        pseudo_labels: PairStore | None = None,
    ) -> None:
        self.store, self.data, self.seed, self.device = store, data, seed, device
        if batch_size % processes or len(store) < processes:
            raise UsageError(
                f"optim.batch_size={batch_size} of {len(store)} pairs is shared by {processes} "
                f"devices: set it to a multiple of {processes}"
            )
        if pseudo_labels and processes > 1:
            raise UsageError("pseudo labels are for one device", "remove {devices}")
        self.pseudo_labels = pseudo_labels
        self._pseudo_label_count = (
            round(batch_size * data.pseudo_label_share) if pseudo_labels else 0
        )
        if pseudo_labels and not 0 < self._pseudo_label_count < min(
            batch_size, len(pseudo_labels) + 1
        ):
            raise UsageError(
                f"data.pseudo_label_share={data.pseudo_label_share} of a batch of {batch_size} is "
                f"{self._pseudo_label_count} of the {len(pseudo_labels)} pseudo labels in each "
                "batch: it has to be at least 1, less than the batch, and not more than there are"
            )
        own = batch_size - self._pseudo_label_count
        self.batch_size = min(own, len(store) // processes * processes)
        self.steps_per_epoch = len(store) // self.batch_size
        self.own_size = (self.batch_size + self._pseudo_label_count) // processes
        self._own = slice(process * self.own_size, (process + 1) * self.own_size)

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
        if self.pseudo_labels is None:
            return self._part(TrainingBatch(*views))
        pseudo_label_rows = self._rows(self.pseudo_labels, step, self._pseudo_label_count, stream=4)
        more = self._augmented(self.pseudo_labels, pseudo_label_rows, size, random)
        return _concatenated(views, more)

    def _part(self, whole: TrainingBatch) -> TrainingBatch:
        """This process's part of a batch."""
        valid_mask = None if whole.valid_mask is None else whole.valid_mask[self._own]
        return TrainingBatch(whole.network_input[self._own], whole.depth_m[self._own], valid_mask)

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
        """Views with the geometry of the pictures (``part`` 0) or of the depth (1)."""
        rgb = store.rgb.index_select(0, rows).to(self.device).float().div_(255)
        depth_m = store.depth_m.index_select(0, rows).to(self.device).float()
        valid_mask = None if store.valid_mask is None else store.valid_mask[rows].to(self.device)
        halves = store.tan_half_fov[rows, part]
        return augment(rgb, depth_m, self.data, random, valid_mask, size, halves)


def _concatenated(views: Views, more: Views) -> TrainingBatch:
    """One batch of the training pairs and the pseudo labels."""
    valid_mask = None
    if views.valid_mask is not None or more.valid_mask is not None:
        valid_mask = torch.cat([_valid_mask_of(views), _valid_mask_of(more)])
    own, labels = len(views.network_input), len(more.network_input)
    is_pseudo_label = torch.arange(own + labels) >= own
    return TrainingBatch(
        torch.cat([views.network_input, more.network_input]),
        torch.cat([views.depth_m, more.depth_m]),
        valid_mask,
        is_pseudo_label.to(views.network_input.device),
    )


def _valid_mask_of(views: Views) -> Tensor:
    everywhere = torch.ones_like(views.depth_m, dtype=torch.bool)
    return everywhere if views.valid_mask is None else views.valid_mask


def _stream_seed(seed: int, count: int, stream: int) -> int:
    return int(np.random.SeedSequence((seed, count, stream)).generate_state(1, np.uint64)[0] >> 1)
