"""Options that several commands have: declared once, so that they mean the same everywhere."""

from __future__ import annotations

from typing import Annotated

import typer

from depthcli.cli import completion
from depthcli.cli.numbers import field_of_view, finite, positive
from depthcli.cli.predict_choices import Colormap, ExrChannel, Near
from depthcli.core.choices import Upsampling
from depthcli.io.writers.formats import Format

MAX_PIXELS = 250_000_000
"""As depthcli.io.decode has it, which would load OpenCV for the help."""

ModelOption = Annotated[
    str | None,
    typer.Option(
        autocompletion=completion.models,
        help="Name ('depthcli models list'), .onnx file, or folder with a card.json.",
    ),
]
ProviderOption = Annotated[
    str,
    typer.Option(
        autocompletion=completion.providers,
        help="auto, cpu, cuda, tensorrt, rocm, migraphx, directml, coreml or openvino. One "
        "asked for by name has to be there.",
    ),
]
ProviderSettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--provider-option",
        metavar="KEY=VALUE",
        help="An option of the provider that --provider names, such as device_id=1; repeatable.",
    ),
]
FormatOption = Annotated[
    list[Format] | None,
    typer.Option(
        "--format",
        help="What to write; repeatable. Default: what -o's suffix says, else png16 and preview.",
    ),
]
PngScaleOption = Annotated[
    float | None,
    typer.Option(
        callback=positive,
        help="Steps a metre in png16: 1000 (default, mm), 256 (KITTI), 5000 (TUM), "
        "4000 (Matterport).",
    ),
]
PngNormalizeOption = Annotated[
    bool, typer.Option("--png-normalize", help="Stretch each png16 to 1-65535; no unit.")
]
ExrChannelOption = Annotated[ExrChannel, typer.Option(help="Name of the channel in EXR.")]
HalfOption = Annotated[bool, typer.Option("--half", help="16-bit floats in EXR.")]
ColormapOption = Annotated[
    Colormap | None,
    typer.Option(help="Colours of the preview. Default: inferno; gray with --near white or black."),
]
NearOption = Annotated[
    Near | None,
    typer.Option(
        help="What near looks like: warm, or white or black in gray. Default: warm; white in gray."
    ),
]
VminOption = Annotated[
    float | None,
    typer.Option(
        callback=finite, help="Least depth with a colour of its own. Default: percentile 2."
    ),
]
VmaxOption = Annotated[
    float | None,
    typer.Option(
        callback=finite, help="Largest depth with a colour of its own. Default: percentile 98."
    ),
]
LegendOption = Annotated[bool, typer.Option("--legend", help="Draw a scale beside the preview.")]
SideBySideOption = Annotated[
    bool, typer.Option("--side-by-side", help="Put the picture beside its preview.")
]
SidecarOption = Annotated[
    bool, typer.Option("--sidecar", help="Also write a .json with unit, scale, kind, model.")
]
FocalPxOption = Annotated[
    float | None,
    typer.Option(
        callback=positive,
        help="Focal length of the camera in pixels of the picture; scales metres.",
    ),
]
HfovOption = Annotated[
    float | None,
    typer.Option(
        callback=field_of_view,
        help="Horizontal field of view in degrees, in place of --focal-px. Default: the "
        "picture's EXIF, else the model's own camera.",
    ),
]
AnchorOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y,METRES",
        help="A point whose depth is known; repeatable. One fits the scale, two or more scale "
        "and shift.",
    ),
]
UpsampleOption = Annotated[
    Upsampling,
    typer.Option(
        help="How depth gets to the picture's size: along the picture's edges, or bilinear."
    ),
]
TileOption = Annotated[
    str | None,
    typer.Option(
        metavar="auto|PIXELS",
        help="Refine pictures in tiles of this width; auto is three quarters of the picture's.",
    ),
]
MaxMemoryOption = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE",
        help="Most memory for one picture, from its pixels to its files, beside the program and "
        "the model: 800M or 2G, say. What needs more is refused.",
    ),
]
MaxPixelsOption = Annotated[
    int, typer.Option(min=1, help="Refuse pictures with more pixels than this.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="One JSON object a line for each input, on stdout.")
]
QuietOption = Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")]
