"""Whatever gives one depth map per image: a model, the files of another tool, a trivial guess."""

from functools import cached_property
from typing import Protocol

from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.datasets.base import DepthDataset, HasCamera, HasFocalLengths
from depthcli.evaluation.choices import Source


class Sample:
    """One image of a data set, decoded only if somebody looks, and only once.

    Attributes:
        id: its name in the data set.
        focal_px: focal length of the picture in its own pixels; None if it is not known.
        hfov_deg: in its place the horizontal field of view in degrees, if that is known.
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
    """One row of the table, or several with different alignments."""

    @property
    def name(self) -> str:
        """What the row is called."""
        ...

    @property
    def source(self) -> Source:
        """Where its numbers come from."""
        ...

    @property
    def kind(self) -> DepthKind:
        """What its predictions mean."""
        ...

    @property
    def model_sha256(self) -> str | None:
        """Checksum of the model file, if there is one."""
        ...

    def predict(self, sample: Sample) -> DepthMap:
        """Depth of one image, any size.

        Raises:
            DepthcliError: there is none.
        """
        ...
