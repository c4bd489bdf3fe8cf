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

    gray: Tensor  #: (B, 1, H, W) float32 in [-1, 1]
    #: (B, 1, H, W) float32 metres, holes filled; of other scenes if unpaired
    depth_m: Tensor
    known: Tensor | None = None  #: (B, 1, H, W) bool, False in the holes; None if there are none
    #: (B,) bool, True for extra pairs; None if there are none
    extra: Tensor | None = None


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
        extra: pairs with less reliable depth, ``data.extra_share`` of each batch; an epoch is a
            pass through ``store``.

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
        extra: PairStore | None = None,
    ) -> None:
        self.store, self.data, self.seed, self.device = store, data, seed, device
        if batch_size % processes or len(store) < processes:
            raise UsageError(
                f"optim.batch_size={batch_size} of {len(store)} pairs is shared by {processes} "
                f"devices: set it to a multiple of {processes}"
            )
        if extra and processes > 1:
            raise UsageError("extra pairs are for one device: remove --devices")
        self.extra = extra
        self._extra_size = round(batch_size * data.extra_share) if extra else 0
        if extra and not 0 < self._extra_size < min(batch_size, len(extra) + 1):
            raise UsageError(
                f"data.extra_share={data.extra_share} of optim.batch_size={batch_size} is "
                f"{self._extra_size} extra pairs in each batch: it has to be at least 1, less than "
                f"the batch, and not more than the {len(extra)} pairs of --extra; set either"
            )
        own = batch_size - self._extra_size
        self.batch_size = min(own, len(store) // processes * processes)
        self.steps_per_epoch = len(store) // self.batch_size
        self.own_size = (self.batch_size + self._extra_size) // processes
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
            views = Views(views.gray, others.depth_m, others.known)
        if self.extra is None:
            return self._part(TrainingBatch(*views))
        extra_rows = self._rows(self.extra, step, self._extra_size, stream=4)
        more = self._augmented(self.extra, extra_rows, size, random)
        return _concatenated(views, more)

    def _part(self, whole: TrainingBatch) -> TrainingBatch:
        """This process's part of a batch."""
        known = None if whole.known is None else whole.known[self._own]
        return TrainingBatch(whole.gray[self._own], whole.depth_m[self._own], known)

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
        known = None if store.known is None else store.known[rows].to(self.device)
        halves = store.tan_half_fov[rows, part]
        return augment(rgb, depth_m, self.data, random, known, size, halves)


def _concatenated(views: Views, more: Views) -> TrainingBatch:
    """One batch of the training pairs and the extra pairs."""
    known = None
    if views.known is not None or more.known is not None:
        known = torch.cat([_known_mask(views), _known_mask(more)])
    extra = torch.arange(len(views.gray) + len(more.gray)) >= len(views.gray)
    return TrainingBatch(
        torch.cat([views.gray, more.gray]),
        torch.cat([views.depth_m, more.depth_m]),
        known,
        extra.to(views.gray.device),
    )


def _known_mask(views: Views) -> Tensor:
    everywhere = torch.ones_like(views.depth_m, dtype=torch.bool)
    return everywhere if views.known is None else views.known


def _stream_seed(seed: int, count: int, stream: int) -> int:
    return int(np.random.SeedSequence((seed, count, stream)).generate_state(1, np.uint64)[0] >> 1)
