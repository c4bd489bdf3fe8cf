"""Options and completions that several commands of the laboratory share."""

from typing import Annotated

import typer

from depthcli.cli.groups import group
from depthcli.cli.options import option
from depthcli.errors import UsageError
from depthcli.lab.options import Weights


@group
class PatternOptions:
    """Names of pairs."""

    rgb: str | None = option(
        "Names of the images in any other layout, with * for the part that an image and its depth "
        "share: '*.color.png' (in any folder), '*/left/*.png'.",
        metavar="PATTERN",
    )
    depth: str | None = option(
        "Names of the depth files, as --rgb: '*.depth.png', '*/gt/*.png'.", metavar="PATTERN"
    )

    @property
    def patterns(self) -> tuple[str, str] | None:
        """Patterns of images and depth; None for a known layout."""
        if (self.rgb is None) != (self.depth is None):
            raise UsageError("", "give both {rgb} and {depth}")
        return (self.rgb, self.depth) if self.rgb and self.depth else None


WeightsOption = Annotated[
    Weights,
    typer.Option(
        help="averaged: the weights' moving average, if there is one; raw: those of the last step."
    ),
]
