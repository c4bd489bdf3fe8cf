"""Pictures and depth images that do not belong together, for methods that learn without pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.datasets.files import (
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    check_plausible,
    median_m,
    read_depth_header,
    read_depth_m,
    read_image_rgb,
    spread,
)
from depthcli.datasets.paired_folder import MILLIMETRES, PLAUSIBLE_M, list_files

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class UnpairedFolder:
    """Two independent lists.

    Attributes:
        root: the folder that holds ``rgb/`` and ``depth/``.
        images: file of each picture.
        depths: file of each depth image; their number and names are their own.
        units_per_metre: what one metre is in the depth images.
    """

    root: Path
    images: tuple[Path, ...]
    depths: tuple[Path, ...]
    units_per_metre: float = MILLIMETRES

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture ``i``: (H, W, 3) RGB uint8.

        Raises:
            DatasetError: it cannot be read.
        """
        return read_image_rgb(self.images[i])

    def depth_m(self, j: int) -> npt.NDArray[np.float32]:
        """Depth image ``j``: (H, W) float32 metres, 0 where there is none.

        Raises:
            DatasetError: it cannot be read.
        """
        return read_depth_m(self.depths[j], self.units_per_metre)


def open_unpaired_folder(path: Path, *, units_per_metre: float = MILLIMETRES) -> UnpairedFolder:
    """List the files of ``rgb/`` and ``depth/``; names need not match.

    Raises:
        DatasetError: a folder is missing or empty, depth is not 16-bit gray PNG, or it is in
            another unit.
    """
    images = list_files(path, "rgb", IMAGE_SUFFIXES)
    depths = list_files(path, "depth", DEPTH_SUFFIXES)
    dataset = UnpairedFolder(
        path,
        tuple(images[name] for name in sorted(images)),
        tuple(depths[name] for name in sorted(depths)),
        units_per_metre,
    )
    for file in dataset.depths:
        read_depth_header(file)
    medians_m = [median_m(dataset.depth_m(j)) for j in spread(len(dataset.depths))]
    check_plausible(medians_m, PLAUSIBLE_M, path)
    return dataset
