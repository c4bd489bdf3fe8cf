"""What is exported, and how."""

from dataclasses import dataclass
from pathlib import Path

from depthcli.core.choices import Weights
from depthcli.export.graph import OPSET
from depthcli.export.parity import HALF_TOLERANCE, INT8_TOLERANCE, TOLERANCE

NO_LICENSE = "NOASSERTION"
"""What SPDX writes where nobody has said under which licence something is."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What is exported."""

    name: str = "custom"  #: of the model
    version: str = "1.0.0"  #: of the model
    half: bool = False  #: store weights as float16; sums stay float32
    mirror: bool = False  #: average with the mirrored picture, at twice the cost
    opset: int = OPSET  #: ONNX operator set
    #: largest difference between torch and onnxruntime; None for the usual one
    tolerance: float | None = None
    int8_pictures: Path | None = None  #: folder of pictures to calibrate int8 on; None keeps floats
    license: str = NO_LICENSE  #: of the weights, an SPDX name
    #: horizontal field of view of the camera that took the training pictures, degrees; None for
    #: what the checkpoint knows of it
    hfov_deg: float | None = None
    float_model: str | None = None  #: name of the model that takes an int8 one's place off the CPU
    #: the average, where the run keeps one, or those of the last step
    weights: Weights = Weights.AVERAGED

    @property
    def allowed(self) -> float:
        """Largest difference that parity lets pass."""
        if self.tolerance is not None:
            return self.tolerance
        if self.int8_pictures is not None:
            return INT8_TOLERANCE
        return HALF_TOLERANCE if self.half else TOLERANCE
