"""``depthcli eval pairs``: the table of metrics for a custom data set."""

from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli.arguments import evaluation, options
from depthcli.cli.arguments.numbers import png_scale_range, positive
from depthcli.core.choices import Upsampling
from depthcli.metrics.choices import Averaging


def pairs(
    *,
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder with rgb/ and depth/ (16-bit PNG, 0 = no depth) of the same names, and "
            "cameras.csv (id,focal_px) if the focal lengths are known.",
        ),
    ],
    model: evaluation.ModelsOption = None,
    predictions: evaluation.PredictionsOption = None,
    predictions_kind: evaluation.PredictionsKindOption = None,
    predictions_scale: evaluation.PredictionsScaleOption = None,
    png_scale: Annotated[
        float | None,
        typer.Option(
            callback=png_scale_range,
            help="Units per metre of the PNG files in depth/: 1000 (default, millimetres), "
            "256 (KITTI), 5000 (TUM), 4000 (Matterport).",
        ),
    ] = None,
    align: evaluation.AlignOption = None,
    average: evaluation.AverageOption = Averaging.IMAGE,
    max_depth: Annotated[
        float,
        typer.Option(
            metavar="METRES",
            callback=positive,
            help="Farthest depth that counts; predictions are clamped to it.",
        ),
    ] = 10.0,
    compare_at: evaluation.CompareAtOption = None,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="ROW",
            help="Also compare this row with every other: paired bootstrap over scenes (subfolders "
            "of rgb/, or scenes of index.csv; an image without one is a scene of its own).",
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
    """Evaluate depth metrics on pictures and depth of your own.

    Metric models are rescaled to the focal length of each picture, where it is known.
    """
    from depthcli.cli.commands.eval.comparison import compare

    compare(locals(), None, model or ([] if predictions else [None]))
