"""The interface of data sets of pictures with measured depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt


class DepthDataset(Protocol):
    """Pairs of a picture and its depth, read one at a time; ``DatasetError`` if that fails."""

    @property
    def ids(self) -> Sequence[str]:
        """Name of each pair, unique."""

    @property
    def scenes(self) -> Sequence[str]:
        """Scene of each pair; "" where it is not known."""

    @property
    def official_split(self) -> Sequence[str]:
        """The data set's own division: "train", "test", or "" where it is not known."""

    def __len__(self) -> int: ...

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture of pair ``i``: (H, W, 3) RGB uint8."""

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i``: (H, W) float32 metres, 0 where there is none."""


@runtime_checkable
class HasRawDepth(Protocol):
    """A data set that also has depth before in-filling."""

    def raw_depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i`` before filling: (H, W) float32 metres, 0 where nothing was measured.

        Raises:
            DatasetError: it is missing or cannot be read.
        """


@runtime_checkable
class HasFiles(Protocol):
    """A data set that may be made of image files."""

    def files(self, i: int) -> Sequence[Path]:
        """Picture and depth image of pair ``i``, as far as they are files."""


@runtime_checkable
class HasFocalLengths(Protocol):
    """A data set that may know the focal length of each picture."""

    @property
    def focal_px(self) -> Sequence[float]:
        """Focal length of each picture, in its own pixels; empty if they are not known."""


@runtime_checkable
class HasScales(Protocol):
    """A data set whose depth may be scaled to one camera."""

    @property
    def scales(self) -> Sequence[float]:
        """Factor on the metres of each pair; empty for 1."""


@runtime_checkable
class HasCamera(Protocol):
    """A data set whose pictures may have been taken with one known camera."""

    @property
    def hfov_deg(self) -> float | None:
        """Horizontal field of view over the full picture width, degrees; None if not known."""
