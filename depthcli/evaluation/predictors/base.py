"""The interface of predictors, which give one depth map per image."""

from functools import cached_property
from typing import Protocol

from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.datasets.base import DepthDataset, HasCamera, HasFocalLengths
from depthcli.evaluation.choices import Source


class Sample:
    """One image of a data set, decoded on first access.

    Attributes:
        id: its name in the data set.
        focal_px: focal length in pixels of the picture; None if unknown.
        hfov_deg: horizontal field of view of the data set's camera in degrees; None if unknown.
    """

    def __init__(self, dataset: DepthDataset, position: int) -> None:
        self.id = dataset.ids[position]
        focal_px = dataset.focal_px if isinstance(dataset, HasFocalLengths) else ()
        self.focal_px = focal_px[position] if focal_px else None
        self.hfov_deg = dataset.hfov_deg if isinstance(dataset, HasCamera) else None
        self._dataset = dataset
        self._position = position

    @cached_property
    def frame(self) -> Frame:
        """The picture."""
        return Frame(self._dataset.image(self._position))


class Predictor(Protocol):
    """Predicts depth for one row of the table, or for several with different alignments."""

    @property
    def name(self) -> str:
        """Name of the row."""

    @property
    def source(self) -> Source:
        """Origin of its predictions."""

    @property
    def kind(self) -> DepthKind:
        """Kind of its depth."""

    @property
    def model_sha256(self) -> str | None:
        """Checksum of the model file, if there is one."""

    def predict(self, sample: Sample) -> DepthMap:
        """Depth of one image, any size.

        Raises:
            DepthcliError: the prediction fails.
        """
