"""Options of an export."""

from dataclasses import dataclass
from pathlib import Path

from depthcli.core.choices import Weights
from depthcli.export.graph import OPSET
from depthcli.export.parity import FLOAT16_TOLERANCE, INT8_TOLERANCE, TOLERANCE


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of an export."""

    name: str = "custom"  #: of the model
    version: str = "1.0.0"  #: of the model
    half: bool = False  #: store weights as float16; computations are in float32
    mirror: bool = False  #: average with the mirrored picture, at twice the cost
    opset: int = OPSET  #: ONNX opset version
    #: maximum difference between torch and onnxruntime; None for the default
    tolerance: float | None = None
    int8_pictures: Path | None = None  #: folder of pictures to calibrate int8; None for no int8
    license: str = "NOASSERTION"  #: of the weights, an SPDX identifier
    #: horizontal field of view of the training pictures, degrees; None for that of the checkpoint
    hfov_deg: float | None = None
    float_model: str | None = None  #: name of the model that replaces an int8 one off the CPU
    #: the moving average, if the run has one, or the weights of the last step
    weights: Weights = Weights.AVERAGED

    @property
    def max_difference(self) -> float:
        """Maximum difference that the parity check accepts."""
        if self.tolerance is not None:
            return self.tolerance
        if self.int8_pictures is not None:
            return INT8_TOLERANCE
        return FLOAT16_TOLERANCE if self.half else TOLERANCE
