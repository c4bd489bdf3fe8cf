"""Options that the commands of ``depthcli eval`` share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import completion
from depthcli.cli.arguments.numbers import png_scale_range
from depthcli.core.choices import Upsampling
from depthcli.errors import UsageError
from depthcli.metrics.choices import Alignment, Averaging

if TYPE_CHECKING:
    from depthcli.core.types import DepthKind

ModelsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--model",
        metavar="MODEL",
        autocompletion=completion.models,
        help="Name or path of a model; repeatable. Default: the bundled model.",
    ),
]
PredictionsOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="DIR",
        help="Folder with predictions of another tool, as ID.npy, ID.exr or ID.png; repeatable.",
    ),
]
PredictionsKindOption = Annotated[
    str | None,
    typer.Option(
        metavar="metric|relative|inverse",
        help="Depth kind of --predictions, if the files do not state it.",
    ),
]
PredictionsScaleOption = Annotated[
    float | None,
    typer.Option(
        callback=png_scale_range,
        help="Units per metre of --predictions in PNG and in NPY of integers, if the files do not "
        "state it: 1000 (PNG's default, millimetres), 256 (KITTI).",
    ),
]
AlignOption = Annotated[
    list[Alignment] | None,
    typer.Option(
        help="Alignment to ground truth per image: none, median (scale), depth or disparity "
        "(least-squares scale and shift); repeatable, one row each. Default: none."
    ),
]
AverageOption = Annotated[Averaging, typer.Option(help="Average over images, or over all pixels.")]
CompareAtOption = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        max=20_000,
        help="Resize prediction and ground truth to N×N first (for example 256).",
    ),
]
BoundaryOption = Annotated[
    bool,
    typer.Option("--boundary", help="Also compute boundary metrics: dbe_acc, dbe_comp, edge_f1."),
]
UpsampleOption = Annotated[
    Upsampling,
    typer.Option(
        help="Upsampling of the models' depth: bilinear as in the protocol, or guided as in "
        "predict."
    ),
]
TrivialOption = Annotated[bool, typer.Option(help="Include baselines that ignore the image.")]
LimitOption = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Evaluate only N images, spread evenly over the split."),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(min=1, max=1024, help="Images processed in parallel. Default: one per core."),
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(min=1, max=1024, help="Inference threads per worker. Default: cores / workers."),
]
CsvOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Also write the table as CSV.")
]
FiguresOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write figures of sample images, in gray and in colour."),
]
IdsOption = Annotated[
    str | None, typer.Option(metavar="A,B", help="Image ids to show in the figures.")
]
HtmlOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write table and figures to one HTML file.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
PerImageOption = Annotated[
    bool, typer.Option("--per-image", help="With --json, also print the scores of each image.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Do not show progress.")]


def shown_ids(ids: str | None, figures: Path | None, html: Path | None) -> tuple[str, ...] | None:
    """Ids of pictures for the figures; empty for some of each scene type, None for no figures.

    Raises:
        UsageError: there are ids, but no figures are requested.
    """
    if ids and not (figures or html):
        raise UsageError("--ids needs --figures DIR or --html FILE")
    if not (figures or html):
        return None
    return tuple(name.strip() for name in (ids or "").split(",") if name.strip())


def parse_kind(name: str | None) -> "DepthKind | None":
    """The depth kind of another tool's files; None if they state it.

    Raises:
        UsageError: there is no such kind.
    """
    from depthcli.core.types import DepthKind

    if name not in {None, *DepthKind}:
        raise UsageError(f"--predictions-kind is {', '.join(DepthKind)}, not {name}")
    return None if name is None else DepthKind(name)
