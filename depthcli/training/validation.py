"""Scores of a generator on held-out pairs, by the headline protocol of the evaluation."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.datasets.base import DepthDataset, HasScales
from depthcli.metrics.accumulate import Accumulator, Scores
from depthcli.metrics.pixels import MAX_DEPTH_M, DepthPixels
from depthcli.training.config.schema import TrainConfig
from depthcli.training.data.pair_store import PairStore, whole_pictures

_BATCH_SIZE = 16


class Validation:
    """Scores a generator on held-out pairs; ground truth is read at full size."""

    def __init__(
        self, dataset: DepthDataset, positions: Sequence[int], config: TrainConfig
    ) -> None:
        self.dataset, self.positions, self.config = dataset, tuple(positions), config
        self.store = PairStore(dataset, positions, config.data)
        scales = dataset.scales if isinstance(dataset, HasScales) else ()
        #: factor by which the depth of each pair was multiplied for the network's camera
        self.scales = [scales[i] if scales else 1.0 for i in positions]

    def __len__(self) -> int:
        return len(self.positions)

    def inputs(self, rows: Sequence[int]) -> Tensor:
        """Network inputs (B, 1, H, W) in [-1, 1] of some of the pairs."""
        return whole_pictures(self.store, self.config.data, torch.tensor(list(rows)))

    @torch.no_grad()
    def raw(self, generator: nn.Module, rows: Sequence[int], device: torch.device) -> Tensor:
        """Raw outputs (B, 1, h, w) float32 on the CPU of some of the pairs."""
        was_training = generator.training
        generator.eval()
        raw: Tensor = generator(self.inputs(rows).to(device)).float().cpu()
        generator.train(was_training)
        return raw

    def score(self, generator: nn.Module, device: torch.device) -> Scores:
        """Mean over the pairs of every metric, at the truth's size, to 10 m or ``output.max_m``.

        Depth that is scaled to one camera is compared in true metres, as in an evaluation.
        """
        total, codec = Accumulator(), self.config.output.codec
        farthest_m = max(MAX_DEPTH_M, self.config.output.max_m)
        for start in range(0, len(self), _BATCH_SIZE):
            rows = range(start, min(start + _BATCH_SIZE, len(self)))
            for row, raw in zip(rows, self.raw(generator, rows, device), strict=True):
                scale = self.scales[row]
                truth_m = self.dataset.depth_m(self.positions[row]) / scale
                depth_m = torch.from_numpy(codec.decode(raw.numpy()))
                grown_m = F.interpolate(depth_m[None], truth_m.shape, mode="bilinear")
                predicted_m = grown_m[0, 0].numpy() / scale
                total.update(DepthPixels.of(truth_m, predicted_m, max_m=farthest_m))
        return total.compute()
