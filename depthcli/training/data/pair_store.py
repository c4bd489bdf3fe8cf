"""Training pairs in memory, at the size that training needs."""

from collections.abc import Sequence

import cv2
import torch
from torch import Tensor

from depthcli.datasets.base import DepthDataset
from depthcli.errors import DatasetError
from depthcli.training.config.schema import DataConfig
from depthcli.training.data.augment import to_network_input
from depthcli.training.data.field_of_view import tan_half_fov
from depthcli.training.data.holes import downsample

_STORED_PER_NETWORK_PX = 2  # twice the network's size leaves detail for zooming in


class PairStore:
    """Pairs of a data set, downsampled once and kept in memory.

    Args:
        dataset: read once.
        positions: of the pairs in the data set.
        data: gives the network's input size.

    Attributes:
        rgb: (N, 3, h, w) uint8.
        depth_m: (N, 1, h, w) float16 metres, exact to 5 mm below 10 m; holes are filled.
        valid_mask: (N, 1, h, w) bool, False in the holes; None if no pair has one.
        tan_half_fov: (N, 2, 2) float64, of each picture and of its depth, which differ only in
            unpaired data: the tangent of half the angle of view, across and down.

    Raises:
        DatasetError: there is no pair, or one without depth.
    """

    def __init__(self, dataset: DepthDataset, positions: Sequence[int], data: DataConfig) -> None:
        if not positions:
            raise DatasetError(
                "no pair to train on: check the data folder, data.holdout_every and "
                "data.holdout_offset"
            )
        size = _stored_size(dataset.image(positions[0]).shape, data)
        shape = (len(positions), 3, size[1], size[0])
        self.rgb = torch.empty(shape, dtype=torch.uint8)
        self.depth_m = torch.empty((len(positions), 1, *shape[2:]), dtype=torch.float16)
        self.valid_mask: Tensor | None = None
        self.tan_half_fov = torch.empty((len(positions), 2, 2), dtype=torch.float64)
        for row, position in enumerate(positions):
            image, depth_m = dataset.image(position), dataset.depth_m(position)
            views = [tan_half_fov(dataset, position, pixels.shape) for pixels in (image, depth_m)]
            self.tan_half_fov[row] = torch.tensor(views, dtype=torch.float64)
            rgb = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            self.rgb[row] = torch.from_numpy(rgb).permute(2, 0, 1)
            measured = downsample(depth_m, size)
            if measured is None:
                raise DatasetError(
                    f"pair {dataset.ids[position]} has almost no depth: remove or repair it"
                )
            self.depth_m[row, 0] = torch.from_numpy(measured.depth_m)
            if measured.valid_mask is not None:
                self._mark_holes(row, torch.from_numpy(measured.valid_mask))

    def __len__(self) -> int:
        return len(self.rgb)

    def _mark_holes(self, row: int, valid_mask: Tensor) -> None:
        if self.valid_mask is None:
            self.valid_mask = torch.ones(self.depth_m.shape, dtype=torch.bool)
        self.valid_mask[row, 0] = valid_mask


def _stored_size(shape: tuple[int, ...], data: DataConfig) -> tuple[int, int]:
    """Width and height in memory: up to twice the network's size, at most about the picture's."""
    most = min(_STORED_PER_NETWORK_PX, max(1.0, shape[1] / data.width, shape[0] / data.height))
    return round(data.width * most), round(data.height * most)


def whole_pictures(store: PairStore, data: DataConfig, rows: Tensor) -> Tensor:
    """Network inputs (B, 1, H, W) in [-1, 1] of stored pairs (B,) int64, without augmentation."""
    rgb = store.rgb[rows].float() / 255
    size = (data.height, data.width)
    gray = to_network_input(rgb, data)  # before resampling, as at inference
    return torch.nn.functional.interpolate(gray, size=size, mode="area")
