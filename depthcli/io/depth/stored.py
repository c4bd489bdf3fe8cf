"""A depth map that was read from a file, with what the file states about it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from depthcli.core.types import DepthMap, Frame, displayed_depth
from depthcli.io.depth.metadata import positive_number
from depthcli.io.depth.quantization import check_units_per_metre
from depthcli.io.formats.table import MILLIMETRES


class StepScale(NamedTuple):
    """Scale of depth that is stored as integers."""

    units_per_metre: float  #: 1000 for millimetres
    source: Literal["file", "option", "assumed"]  #: who states it


@dataclass(frozen=True, slots=True, eq=False)
class StoredDepth:
    """A depth map that was read from a file.

    Attributes:
        name: the file.
        depth: the map, of an EXR over its data window.
        metadata: metadata of the file and its sidecar, texts by name.
        scale: of integers; None if the file holds floats, or is normalized.
        frame: without a picture; has the windows, the shape of pixels, the rate and the time code
            of an EXR.
        channel: of an EXR, that the depth is read from; None for other files.
        warnings: one line each.
    """

    name: str
    depth: DepthMap
    metadata: Mapping[str, str]
    scale: StepScale | None = None
    frame: Frame = field(default_factory=lambda: Frame(np.zeros((1, 1), np.uint8)))
    channel: str | None = None
    warnings: tuple[str, ...] = ()

    @property
    def displayed(self) -> DepthMap:
        """The map, of an EXR in its display window."""
        return displayed_depth(self.depth, self.frame.windows)

    def warnings_with_scale(self, option: str) -> tuple[str, ...]:
        """The warnings, and one if the scale is assumed, which names the option that states it."""
        if self.scale is None or self.scale.source != "assumed":
            return self.warnings
        assumed = f"{self.name} states no scale, so millimetres are assumed"
        return (*self.warnings, f"{assumed}; {option} states another")


def step_scale(metadata: Mapping[str, str], option: float | None) -> StepScale | None:
    """Scale of the integers in a file; None if they are normalized.

    Args:
        metadata: metadata of the file.
        option: units per metre that the user states; None for what the file states, or millimetres.

    Raises:
        UsageError: the option is not a number above 0.
    """
    if option is not None:
        check_units_per_metre(option)
        return StepScale(option, "option")
    if metadata.get("scale") == "normalized":
        return None
    stated = positive_number(metadata.get("scale"))
    return StepScale(MILLIMETRES, "assumed") if stated is None else StepScale(stated, "file")
