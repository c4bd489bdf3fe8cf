"""Unpaired pictures and depth images, for methods that are trained without pairs."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from depthcli.datasets.files import (
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    check_plausible,
    depth_shape,
    median_m,
    read_depth_m,
    read_image_rgb,
    sample_positions,
)
from depthcli.datasets.paired_folder import PLAUSIBLE, list_files
from depthcli.io.formats.table import MILLIMETRES


@dataclass(frozen=True)
class UnpairedFolder:
    """Independent pictures and depth images; a :class:`~depthcli.datasets.base.DepthDataset`.

    It is as long as the longer list, and the shorter one is repeated. Pictures and depth images at
    the same position are not related, and their sizes can differ.
    """

    images: tuple[Path, ...]  #: file of each picture
    depths: tuple[Path, ...]  #: file of each depth image
    units_per_metre: float = MILLIMETRES  #: value of one metre in the depth images

    def __len__(self) -> int:
        return max(len(self.images), len(self.depths))

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Names of the picture and the depth image at each position."""
        names = ((self._image(i).name, self._depth(i).name) for i in range(len(self)))
        return tuple(f"{image} {depth}" for image, depth in names)

    @property
    def scenes(self) -> tuple[str, ...]:
        """Not known: no pair can be held out."""
        return ("",) * len(self)

    @property
    def official_split(self) -> tuple[str, ...]:
        """Not known."""
        return ("",) * len(self)

    def files(self, i: int) -> tuple[Path, ...]:
        """Picture and depth image at position ``i``."""
        return (self._image(i), self._depth(i))

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture ``i``: (H, W, 3) RGB uint8."""
        return read_image_rgb(self._image(i))

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth image ``i``: (H, W) float32 metres, 0 where there is none."""
        return read_depth_m(self._depth(i), self.units_per_metre)

    def _image(self, i: int) -> Path:
        return self.images[i % len(self.images)]

    def _depth(self, i: int) -> Path:
        return self.depths[i % len(self.depths)]


def open_unpaired_folder(path: Path, *, units_per_metre: float = MILLIMETRES) -> UnpairedFolder:
    """List the files of ``rgb/`` and ``depth/``; names need not match.

    Raises:
        DatasetError: a folder is missing or empty, depth is not 16-bit gray PNG, or it is in
            another unit.
    """
    images = list_files(path, "rgb", IMAGE_SUFFIXES)
    depths = list_files(path, "depth", DEPTH_SUFFIXES)
    dataset = UnpairedFolder(
        tuple(images[name] for name in sorted(images)),
        tuple(depths[name] for name in sorted(depths)),
        units_per_metre,
    )
    for file in dataset.depths:
        depth_shape(file)
    medians_m = [
        median_m(read_depth_m(dataset.depths[j], units_per_metre))
        for j in sample_positions(len(depths))
    ]
    check_plausible(medians_m, PLAUSIBLE, path)
    return dataset
