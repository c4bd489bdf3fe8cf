"""What is exported, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.core.choices import Weights
from depthcli.export.graph import OPSET
from depthcli.export.parity import HALF_TOLERANCE, INT8_TOLERANCE, TOLERANCE

if TYPE_CHECKING:
    from pathlib import Path

NO_LICENSE = "NOASSERTION"
"""What SPDX writes where nobody has said under which licence something is."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What is exported.

    Attributes:
        name: of the model.
        version: of the model.
        half: store weights as float16; sums stay float32.
        mirror: average with the mirrored picture, at twice the cost.
        opset: ONNX operator set.
        tolerance: largest difference between torch and onnxruntime; None for the usual one.
        int8_pictures: folder of pictures to calibrate int8 on; None keeps floats.
        license: of the weights, an SPDX name.
        hfov_deg: horizontal field of view of the camera that took the training pictures, degrees;
            None for what the checkpoint knows of it.
        weights: the average, where the run keeps one, or those of the last step.
    """

    name: str = "custom"
    version: str = "1.0.0"
    half: bool = False
    mirror: bool = False
    opset: int = OPSET
    tolerance: float | None = None
    int8_pictures: Path | None = None
    license: str = NO_LICENSE
    hfov_deg: float | None = None
    weights: Weights = Weights.AVERAGED

    @property
    def allowed(self) -> float:
        """Largest difference that parity lets pass."""
        if self.tolerance is not None:
            return self.tolerance
        if self.int8_pictures is not None:
            return INT8_TOLERANCE
        return HALF_TOLERANCE if self.half else TOLERANCE
