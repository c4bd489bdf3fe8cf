"""``depthcli eval nyu``: the table of metrics on NYU Depth v2."""

from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli.arguments import evaluation, options
from depthcli.core.choices import Upsampling
from depthcli.datasets.splits import SplitName
from depthcli.errors import UsageError
from depthcli.evaluation.choices import Crop, Mask
from depthcli.metrics.choices import Averaging


def nyu(
    *,
    data: Annotated[
        Path,
        typer.Option(
            envvar="DEPTHCLI_NYU",
            help="nyu_depth_v2_labeled.mat, or a folder with it or with rgb/, depth/, index.csv.",
        ),
    ],
    model: evaluation.ModelsOption = None,
    no_model: Annotated[
        bool, typer.Option("--no-model", help="Do not evaluate the bundled model.")
    ] = False,
    predictions: evaluation.PredictionsOption = None,
    predictions_kind: evaluation.PredictionsKindOption = None,
    predictions_scale: evaluation.PredictionsScaleOption = None,
    split: Annotated[
        SplitName,
        typer.Option(
            help="paper: 1-1000 train, 1001-1449 test. official: 795/654. val: held-out scenes "
            "of the first 1000."
        ),
    ] = SplitName.PAPER,
    align: evaluation.AlignOption = None,
    average: evaluation.AverageOption = Averaging.IMAGE,
    compare_at: evaluation.CompareAtOption = None,
    crop: Annotated[
        Crop, typer.Option(help="eigen: rows 45:471, columns 41:601 only.")
    ] = Crop.NONE,
    mask: Annotated[
        Mask, typer.Option(help="raw: only where the sensor measured depth.")
    ] = Mask.FILLED,
    trivial: evaluation.TrivialOption = True,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="ROW",
            help="Also compare this row with every other: paired bootstrap over scenes.",
        ),
    ] = None,
    boundary: evaluation.BoundaryOption = False,
    upsample: evaluation.UpsampleOption = Upsampling.BILINEAR,
    tile: options.TileOption = None,
    limit: evaluation.LimitOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    workers: evaluation.WorkersOption = None,
    threads: evaluation.ThreadsOption = None,
    as_json: evaluation.JsonOption = False,
    per_image: evaluation.PerImageOption = False,
    csv: evaluation.CsvOption = None,
    figures: evaluation.FiguresOption = None,
    ids: evaluation.IdsOption = None,
    html: evaluation.HtmlOption = None,
    quiet: evaluation.QuietOption = False,
) -> None:
    """Evaluate depth metrics on NYU Depth v2."""
    from depthcli.cli.commands.eval.comparison import compare

    if model and no_model:
        raise UsageError("--model and --no-model exclude each other: give one of them")
    needs_default = not (model or no_model or predictions)
    compare(locals(), split, [None] if needs_default else model or [])
