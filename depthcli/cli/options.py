"""Options that several commands share."""

import math
import re
from collections.abc import Callable
from enum import StrEnum
from typing import Annotated

import typer

from depthcli.cli import completion
from depthcli.core.camera import FOCAL_PX, HFOV_DEG
from depthcli.core.options import EXPOSURE, Colormap, Near, Upsampling, Weights
from depthcli.core.text import short_repr
from depthcli.core.validation import Rule
from depthcli.errors import UsageError
from depthcli.io.formats.table import Format

_LARGEST_M = 1e9
_LARGEST_PX = 20_000


def _must_be(rule: Rule) -> Callable[[float | None], float | None]:
    """A callback of typer that refuses a value, unless it is None."""

    def check(value: float | None) -> float | None:
        if value is not None and not rule.holds(value):
            raise typer.BadParameter(f"must be {rule.what}")
        return value

    return check


finite = _must_be(Rule("a number up to 1e9", lambda x: abs(x) <= _LARGEST_M))
positive = _must_be(Rule("greater than 0", lambda x: 0 < x < math.inf))
not_negative = _must_be(Rule("0 or greater", lambda x: 0 <= x < math.inf))
png_scale_range = _must_be(Rule("from 0.001 to 1000000", lambda x: 1e-3 <= x <= 1e6))  # noqa: PLR2004
focal_length = _must_be(FOCAL_PX)
field_of_view = _must_be(HFOV_DEG)
stops = _must_be(EXPOSURE)


def parse_size(word: str) -> tuple[int, int]:
    """Parse a width and height such as ``640x480``.

    Raises:
        UsageError: it is not of this form, or too large.
    """
    sides = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", word)
    if not sides:
        raise UsageError(f"--size {short_repr(word)} is not WIDTHxHEIGHT; for example 640x480")
    width, height = map(int, sides.groups())
    if not (0 < width <= _LARGEST_PX and 0 < height <= _LARGEST_PX):
        raise UsageError(f"--size {word!r}: each side is 1 to {_LARGEST_PX} pixels")
    return width, height


def parse_hfov_range(word: str) -> tuple[float, float]:
    """Parse a range of degrees such as ``30-110``, or one value such as ``63.3``.

    Raises:
        UsageError: it is not of this form, or out of range.
    """
    low, dash, high = word.partition("-")
    try:
        angles = float(low), float(high if dash else low)
    except ValueError:
        raise UsageError(f"--hfov {word!r} is not LOW-HIGH; for example 50-80") from None
    if angles[0] > angles[1] or not all(map(HFOV_DEG.holds, angles)):
        raise UsageError(f"--hfov {word!r}: each is {HFOV_DEG.what}, the smaller first")
    return angles


class ExrChannel(StrEnum):
    """EXR channel names that other programs expect."""

    Z = "Z"
    Y = "Y"
    R = "R"
    DEPTH_Z = "depth.Z"


ModelOption = Annotated[
    str | None,
    typer.Option(
        "--model",  # typer 0.27 would take the metavar for the name
        metavar="MODEL",
        autocompletion=completion.models,
        help="Name ('depthcli models list'), .onnx file, or folder with a card.json.",
    ),
]
ProviderOption = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        autocompletion=completion.providers,
        help="auto, cpu, cuda, tensorrt, rocm, migraphx, directml, coreml or openvino. A "
        "provider requested by name must be available.",
    ),
]
ProviderSettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--provider-option",
        metavar="KEY=VALUE",
        help="Option of the provider given with --provider, such as device_id=1; repeatable.",
    ),
]
FormatOption = Annotated[
    list[Format] | None,
    typer.Option(
        "--format",
        help="Output format; repeatable. Default: from the suffix of -o, else png16 and preview.",
    ),
]
PngScaleOption = Annotated[
    float | None,
    typer.Option(
        callback=png_scale_range,
        help="PNG units per metre: 1000 (default, millimetres), 256 (KITTI), 5000 (TUM), "
        "4000 (Matterport).",
    ),
]
PngNormalizeOption = Annotated[
    bool,
    typer.Option(
        "--png-normalize",
        help="Normalize each png16 to 1-65535; the depth range is stored in its metadata.",
    ),
]
ExrChannelOption = Annotated[
    ExrChannel,
    typer.Option(
        help="EXR channel name: most programs show Y; depth nodes of compositors expect Z or "
        "depth.Z."
    ),
]
HalfOption = Annotated[bool, typer.Option("--half", help="Write EXR as 16-bit half floats.")]
ColormapOption = Annotated[
    Colormap | None,
    typer.Option(
        help="Colormap of the preview. Default: inferno, or gray with --near white or black."
    ),
]
NearOption = Annotated[
    Near | None,
    typer.Option(
        help="Colour of near depth: warm, or white or black with gray. Default: warm, or white "
        "with gray."
    ),
]
VminOption = Annotated[
    float | None,
    typer.Option(
        callback=finite,
        help="Lower end of the depth range of previews (and of a normalized depth video), in "
        "metres if metric. Default: 2nd percentile.",
    ),
]
VmaxOption = Annotated[
    float | None,
    typer.Option(
        callback=finite,
        help="Upper end of the depth range of previews (and of a normalized depth video), in "
        "metres if metric. Default: 98th percentile.",
    ),
]
LegendOption = Annotated[
    bool, typer.Option("--legend", help="Draw a colour scale beside the preview.")
]
SideBySideOption = Annotated[
    bool, typer.Option("--side-by-side", help="Show the input picture beside the preview.")
]
SidecarOption = Annotated[
    bool,
    typer.Option("--sidecar", help="Also write a .json file with unit, scale, kind and model."),
]
CentrePxOption = Annotated[
    str | None,
    typer.Option(
        metavar="CX,CY",
        help="Principal point in pixels, for point clouds and for the metadata of the outputs; 0,0 "
        "is the middle of the first pixel. Default: the middle of the picture; for 'convert' that "
        "of the input, if it states one.",
    ),
]
FocalPxOption = Annotated[
    float | None,
    typer.Option(
        callback=focal_length, help="Focal length in pixels of the picture; scales metric depth."
    ),
]
HfovOption = Annotated[
    float | None,
    typer.Option(
        callback=field_of_view,
        help="Horizontal field of view in degrees, instead of --focal-px. Default: from EXIF, "
        "else the model's camera.",
    ),
]
CalibrationOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Calibration of the camera, instead of --focal-px and --centre-px: camera_info YAML "
        "of ROS, or YAML, XML or JSON of OpenCV.",
    ),
]
RectifiedOption = Annotated[
    bool,
    typer.Option(
        "--rectified",
        help="The pictures are rectified: the camera is that of projection_matrix (P) in "
        "--calibration, without distortion.",
    ),
]
AnchorOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y,METRES",
        help="Point of known depth: column and row from 0 at the top left, and metres; "
        "repeatable. One point fits the scale, two or more also a shift.",
    ),
]
AnchorsOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Known depth, such as that of a lidar: a CSV table with the columns x, y and depth_m, "
        "or a sparse depth map of the picture's size (16-bit PNG, EXR, NPY; 0 or NaN is unknown). "
        "For 'batch', a folder with such a file for each picture.",
    ),
]
AnchorsScaleOption = Annotated[
    float | None,
    typer.Option(
        callback=png_scale_range,
        help="Units per metre of --anchors in PNG or NPY of integers (default of PNG: from the "
        "file, else 1000).",
    ),
]
WhiteLevelOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=65535,
        help="Value of white in 16-bit pictures of a camera with fewer bits: 1023 (10 bits), 4095 "
        "(12), 16383 (14). Default: 65535.",
    ),
]
ExposureOption = Annotated[
    float,
    typer.Option(
        callback=stops,
        metavar="STOPS",
        help="Exposure of EXR pictures in stops: 1 doubles their linear light, -1 halves it.",
    ),
]
LayerOption = Annotated[
    str | None,
    typer.Option(
        help="Layer or part of EXR pictures to read, such as 'beauty'. Default: that without a "
        "name, else the likeliest by its name."
    ),
]
UpsampleOption = Annotated[
    Upsampling,
    typer.Option(
        help="Upsampling to the picture's size: guided by the picture's edges, or bilinear."
    ),
]
TileOption = Annotated[
    str | None,
    typer.Option(
        metavar="auto|PIXELS",
        help="Refine the depth in tiles of this width; auto is 3/4 of the picture's width.",
    ),
]
MaxPixelsOption = Annotated[int, typer.Option(min=1, help="Maximum number of pixels of a picture.")]
WeightsOption = Annotated[
    Weights,
    typer.Option(
        help="averaged: the moving average, if the run keeps one; raw: those of the last step."
    ),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object per input to stdout.")
]
JsonObjectOption = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
JsonOutputOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
QuietOption = Annotated[bool, typer.Option("-q", "--quiet", help="Print errors only.")]
