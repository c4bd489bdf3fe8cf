"""Some pairs of a data set, as a data set."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from depthcli.datasets.base import DepthDataset, HasCamera, HasFiles, HasFocalLengths, HasScales


@dataclass(frozen=True)
class Subset:
    """The pairs at some positions; a :class:`~depthcli.datasets.base.DepthDataset`."""

    whole: DepthDataset  #: the whole data set
    positions: tuple[int, ...]  #: positions of the pairs in it, in their order

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Name of each pair."""
        names = self.whole.ids
        return tuple(names[i] for i in self.positions)

    @property
    def scenes(self) -> tuple[str, ...]:
        """Scene of each pair."""
        scenes = self.whole.scenes
        return tuple(scenes[i] for i in self.positions)

    @property
    def official_split(self) -> tuple[str, ...]:
        """The data set's own division."""
        parts = self.whole.official_split
        return tuple(parts[i] for i in self.positions)

    @property
    def focal_px(self) -> tuple[float, ...]:
        """Focal length of each picture, in its own pixels; empty if they are not known."""
        focal_px = self.whole.focal_px if isinstance(self.whole, HasFocalLengths) else ()
        return tuple(focal_px[i] for i in self.positions) if focal_px else ()

    @property
    def scales(self) -> tuple[float, ...]:
        """Factor on the metres of each pair; empty for 1."""
        scales = self.whole.scales if isinstance(self.whole, HasScales) else ()
        return tuple(scales[i] for i in self.positions) if scales else ()

    @property
    def hfov_deg(self) -> float | None:
        """Horizontal field of view over the full picture width, degrees; None if not known."""
        return self.whole.hfov_deg if isinstance(self.whole, HasCamera) else None

    def files(self, i: int) -> Sequence[Path]:
        """Picture and depth image of pair ``i``, as far as they are files."""
        return self.whole.files(self.positions[i]) if isinstance(self.whole, HasFiles) else ()

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture of pair ``i``: (H, W, 3) RGB uint8."""
        return self.whole.image(self.positions[i])

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i``: (H, W) float32 metres, 0 where there is none."""
        return self.whole.depth_m(self.positions[i])
