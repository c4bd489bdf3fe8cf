"""The parts of a model's card: input, output, camera and file."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, TypeAlias

from depthcli.core.camera import HFOV_DEG
from depthcli.core.codec import DepthCodec, Transform
from depthcli.core.types import DepthKind
from depthcli.core.validation import Rule

MAX_INPUT_PIXELS = 2**24
"""With more, the first layers of a network take more memory than machines have."""
_MAX_SIDE = 2**15
_Side: TypeAlias = Annotated[
    int, Rule(f"a whole number from 1 to {_MAX_SIDE}", lambda px: 1 <= px <= _MAX_SIDE)
]
_MAX_TEXT = 1000
Text: TypeAlias = Annotated[
    str,
    Rule(
        f"at most {_MAX_TEXT} printable characters, and not empty",
        lambda text: text.isprintable() and bool(text.strip()) and len(text) <= _MAX_TEXT,
    ),
]
Count: TypeAlias = Annotated[int, Rule("a whole number from 1 up", lambda number: number >= 1)]
# With larger numbers, sums of 32-bit floats would be constant or not finite.
_LARGEST = 1e9
_Number: TypeAlias = Annotated[
    float, Rule("a number from -1e9 to 1e9", lambda number: abs(number) <= _LARGEST)
]
_Factor: TypeAlias = Annotated[
    float,
    Rule(
        "a number other than 0, from -1e9 to 1e9",
        lambda number: 1 / _LARGEST <= abs(number) <= _LARGEST,
    ),
]
_Ratio: TypeAlias = Annotated[
    float,
    Rule("a number above 0, up to 1e9", lambda number: 1 / _LARGEST <= number <= _LARGEST),
]
_Aspect: TypeAlias = Annotated[
    float, Rule("a number from 0.01 to 100", lambda number: 0.01 <= number <= 100)  # noqa: PLR2004
]


class Colour(StrEnum):
    """The colours that a network takes."""

    VALUE = "value"
    """V of HSV, the largest of R, G and B."""
    LUMA = "luma"
    """Weighted sum of R, G and B."""
    RGB = "rgb"

    @property
    def channels(self) -> int:
        """Planes of the network's input."""
        return 3 if self is Colour.RGB else 1


class Fit(StrEnum):
    """How a picture is fitted to the network's size."""

    STRETCH = "stretch"
    """To width x height, without keeping the aspect."""
    KEEP_ASPECT = "keep-aspect"
    """The picture's aspect is kept: same pixel count if the size is dynamic, else a letterbox.

    A dynamic size is no longer than 2 : 1; longer pictures are padded to that.
    """
    LOWER_BOUND = "lower-bound"
    """Dynamic only: the aspect is kept, and neither side is below the nominal size."""
    UPPER_BOUND = "upper-bound"
    """Dynamic only: the aspect is kept, and neither side is above the nominal size."""


class Resize(StrEnum):
    """How a picture is resized to the network's input."""

    AREA = "area"
    """Mean over each output pixel's area when shrinking, bilinear when enlarging."""
    LINEAR = "linear"
    """Bilinear, half-pixel centres, no antialiasing."""
    CUBIC = "cubic"
    """Bicubic (a = -0.75), half-pixel centres, no antialiasing: OpenCV's INTER_CUBIC."""


class TensorLayout(StrEnum):
    """Order of the axes of the network's input."""

    NCHW = "nchw"
    """Picture, channel, row, column."""
    NHWC = "nhwc"
    """Picture, row, column, channel, the default of TensorFlow's converters."""


@dataclass(frozen=True, slots=True)
class InputSpec:
    """The network's input, float32: ``(colour in [0, 1] - mean) / std``."""

    colour: Colour  #: the channels
    width: _Side  #: columns in pixels; the nominal size where it is dynamic
    height: _Side  #: rows in pixels
    dynamic: bool  #: whether any multiple of ``multiple_of`` is a valid width and height
    multiple_of: _Side  #: granularity of a dynamic size, in pixels
    fit: Fit  #: how the picture is fitted to this size
    mean: tuple[_Number, ...]  #: one number a channel, or one for all
    std: tuple[_Ratio, ...]  #: one number a channel, or one for all
    resize: Resize = Resize.AREA  #: how the picture is resized
    layout: TensorLayout = TensorLayout.NCHW  #: order of the axes
    #: width over height of the network's pixels as it learned them, in pixels of the picture: 4/3
    #: if it learned pictures of 4:3 stretched to a square. For ``stretch`` and ``keep-aspect``
    pixel_aspect: _Aspect = 1.0


@dataclass(frozen=True, slots=True)
class OutputSpec:
    """The meaning of the network's raw output; see :class:`DepthCodec`."""

    kind: DepthKind  #: metric, relative or inverse
    transform: Transform  #: how depth follows from ``scale * raw + shift``
    scale: _Factor  #: factor on the raw output
    shift: _Number  #: added after the factor
    min_m: float | None = None  #: least depth in metres; None if the kind is not metric
    max_m: _Ratio | None = None  #: largest depth in metres; None if the kind is not metric

    @property
    def codec(self) -> DepthCodec:
        """The mapping from raw output to depth."""
        return DepthCodec(self.transform, self.scale, self.shift)


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """The camera that the model was trained on."""

    #: horizontal field of view over the full picture width, in degrees
    hfov_deg: Annotated[float, HFOV_DEG]


@dataclass(frozen=True, slots=True)
class OnnxSpec:
    """Versions that decide which onnxruntime can load the file, and which output is the map."""

    opset: Count
    ir: Count
    output: Text | None = None  #: name of the output that is the depth map; None for the only one
