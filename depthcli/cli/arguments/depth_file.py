"""Arguments of the commands that read a depth file: ``info``, ``probe`` and ``convert``."""

from typing import Annotated

import typer

from depthcli.cli.arguments.numbers import png_scale_range

FileArgument = Annotated[
    str,
    typer.Argument(metavar="FILE", help="Depth file: 16-bit PNG, EXR, NPY or depth video (.mkv)."),
]
ScaleOption = Annotated[
    float | None,
    typer.Option(
        callback=png_scale_range,
        help="Units per metre of a PNG or video (default: from the file, else 1000), or NPY of "
        "integers.",
    ),
]
FrameOption = Annotated[
    int | None, typer.Option(min=0, help="The frame of a depth video (.mkv) to read, from 0.")
]
