"""Options that the commands of ``depthcli eval`` share."""

from pathlib import Path
from typing import Annotated

import typer

from depthcli.errors import UsageError

TrivialOption = Annotated[bool, typer.Option(help="Include baselines that ignore the picture.")]
LimitOption = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Evaluate only N images, spread evenly over the split."),
]
CsvOption = Annotated[Path | None, typer.Option(help="Also write the table as CSV.")]
FiguresOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write figures of sample pictures, in gray and in colour."),
]
IdsOption = Annotated[
    str | None, typer.Option(metavar="A,B", help="Picture ids to show in the figures.")
]
HtmlOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write table and figures to one HTML file.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Do not show progress.")]


def shown_ids(ids: str | None, figures: Path | None, html: Path | None) -> tuple[str, ...] | None:
    """Pictures to draw: those named, none for some of every type, None for no figures at all.

    Raises:
        UsageError: some are named, but nothing is drawn.
    """
    if ids and not (figures or html):
        raise UsageError("--ids needs --figures DIR or --html FILE")
    if not (figures or html):
        return None
    return tuple(name.strip() for name in (ids or "").split(",") if name.strip())
