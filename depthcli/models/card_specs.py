"""What a model's card says of its input, its output, its camera and its file."""

from dataclasses import dataclass
from enum import StrEnum

from depthcli.core.codec import DepthCodec, Transform
from depthcli.core.types import DepthKind


class Colour(StrEnum):
    """What the network sees of a picture."""

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
    """How a picture is brought to the network's size."""

    STRETCH = "stretch"
    """Straight to width x height, whatever the aspect."""
    KEEP_ASPECT = "keep-aspect"
    """The picture's aspect is kept: same pixel count if the size is dynamic, else a letterbox.

    A dynamic size is no longer than 2 : 1; longer pictures are padded to that.
    """
    LOWER_BOUND = "lower-bound"
    """Dynamic only: the aspect is kept, and neither side is below the nominal size."""
    UPPER_BOUND = "upper-bound"
    """Dynamic only: the aspect is kept, and neither side is above the nominal size."""


class Resize(StrEnum):
    """How a picture's pixels become those of the network's input."""

    AREA = "area"
    """Mean over each pixel's area where it shrinks, bilinear where it grows."""
    LINEAR = "linear"
    """Bilinear, half-pixel centres, no antialiasing."""
    CUBIC = "cubic"
    """Bicubic (a = -0.75), half-pixel centres, no antialiasing: OpenCV's INTER_CUBIC."""


class TensorLayout(StrEnum):
    """Order of the axes of the network's input."""

    NCHW = "nchw"
    """Picture, channel, row, column."""
    NHWC = "nhwc"
    """Picture, row, column, channel, as TensorFlow's converters write it."""


@dataclass(frozen=True, slots=True)
class InputSpec:
    """The network's input, float32: ``(colour in [0, 1] - mean) / std``."""

    colour: Colour  #: what is made of the picture's pixels
    width: int  #: columns in pixels; the nominal size where it is dynamic
    height: int  #: rows in pixels
    dynamic: bool  #: whether any multiple of ``multiple_of`` is a valid width and height
    multiple_of: int  #: granularity of a dynamic size, in pixels
    fit: Fit  #: how the picture is brought to this size
    mean: tuple[float, ...]  #: one number a channel, or one for all
    std: tuple[float, ...]  #: one number a channel, or one for all
    resize: Resize = Resize.AREA  #: how the picture is resized
    layout: TensorLayout = TensorLayout.NCHW  #: order of the axes
    #: width over height of the network's pixels as it learned them, in pixels of the picture: 4/3
    #: if it learned pictures of 4:3 stretched to a square. For ``stretch`` and ``keep-aspect``
    pixel_aspect: float = 1.0


@dataclass(frozen=True, slots=True)
class OutputSpec:
    """What the network's raw output means; see :class:`DepthCodec`."""

    kind: DepthKind  #: metric, relative or inverse
    transform: Transform  #: how depth follows from ``scale * raw + shift``
    scale: float  #: factor on the raw output
    shift: float  #: added after the factor
    min_m: float | None  #: least depth in metres; None if the kind is not metric
    max_m: float | None  #: largest depth in metres; None if the kind is not metric

    @property
    def codec(self) -> DepthCodec:
        """The mapping from raw output to depth."""
        return DepthCodec(self.transform, self.scale, self.shift)


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """The camera whose metres the model learned."""

    hfov_deg: float  #: horizontal field of view over the full picture width, in degrees


@dataclass(frozen=True, slots=True)
class OnnxSpec:
    """Versions that decide which onnxruntime can load the file."""

    opset: int
    ir: int
