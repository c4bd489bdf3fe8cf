"""``depthcli eval``: the table of metrics for models, files of other tools and trivial rows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import completion, options
from depthcli.cli.commands.eval.runs import runs
from depthcli.cli.screen import console
from depthcli.core.choices import Upsampling
from depthcli.datasets.splits import SplitName
from depthcli.errors import UsageError
from depthcli.evaluation.choices import Crop, Mask
from depthcli.metrics.choices import Alignment, Averaging

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.evaluation.predictors.base import Predictor
    from depthcli.evaluation.reports.figures import Figure

app = typer.Typer(rich_markup_mode=None, no_args_is_help=True, help="Compare models on a data set.")


@app.callback()
def _group() -> None:
    """Compare models on a data set."""


app.command()(runs)


@app.command()
def nyu(
    *,
    data: Annotated[
        Path,
        typer.Option(
            envvar="DEPTHCLI_NYU",
            help="nyu_depth_v2_labeled.mat, or a folder with it or with rgb/, depth/, index.csv.",
        ),
    ],
    model: Annotated[
        list[str] | None,
        typer.Option(
            autocompletion=completion.models,
            help="Name or path of a model; repeatable. Default: the bundled model.",
        ),
    ] = None,
    no_model: Annotated[
        bool, typer.Option("--no-model", help="Do not evaluate the bundled model.")
    ] = False,
    predictions: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder with predictions of another tool, as ID.npy, ID.exr or ID.png; repeatable."
        ),
    ] = None,
    predictions_kind: Annotated[
        str | None,
        typer.Option(
            metavar="metric|relative|inverse",
            help="Depth kind of --predictions, if the files do not state it.",
        ),
    ] = None,
    split: Annotated[
        SplitName,
        typer.Option(
            help="paper: 1-1000 train, 1001-1449 test. official: 795/654. val: held-out scenes "
            "of the first 1000."
        ),
    ] = SplitName.PAPER,
    align: Annotated[
        list[Alignment] | None,
        typer.Option(
            help="Alignment to ground truth per image: none, median (scale), depth or disparity "
            "(least-squares scale and shift); repeatable, one row each. Default: none."
        ),
    ] = None,
    average: Annotated[
        Averaging, typer.Option(help="Average over images, or over all pixels.")
    ] = Averaging.IMAGE,
    compare_at: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Resize prediction and ground truth to N×N first (for example 256).",
        ),
    ] = None,
    crop: Annotated[
        Crop, typer.Option(help="eigen: rows 45:471, columns 41:601 only.")
    ] = Crop.NONE,
    mask: Annotated[
        Mask, typer.Option(help="raw: only where the sensor measured depth.")
    ] = Mask.FILLED,
    trivial: Annotated[
        bool, typer.Option(help="Include baselines that ignore the picture.")
    ] = True,
    boundary: Annotated[
        bool,
        typer.Option(
            "--boundary", help="Also compute boundary metrics: dbe_acc, dbe_comp, edge_f1."
        ),
    ] = False,
    upsample: Annotated[
        Upsampling,
        typer.Option(
            help="Upsampling of the models' depth: bilinear as in the protocol, or guided as in "
            "predict."
        ),
    ] = Upsampling.BILINEAR,
    tile: options.TileOption = None,
    limit: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, help="Evaluate only N images, spread evenly over the split."
        ),
    ] = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Images processed in parallel. Default: one per core."),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(min=1, help="Inference threads per worker. Default: cores / workers."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    per_image: Annotated[
        bool, typer.Option("--per-image", help="With --json, also print the scores of each image.")
    ] = False,
    csv: Annotated[Path | None, typer.Option(help="Also write the table as CSV.")] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write figures of sample pictures, in gray and in colour."
        ),
    ] = None,
    ids: Annotated[
        str | None, typer.Option(metavar="A,B", help="Picture ids to show in the figures.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write table and figures to one HTML file.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Do not show progress.")] = False,
) -> None:
    """Evaluate depth metrics on NYU Depth v2."""
    from depthcli.cli.arguments.detail import choose_detail
    from depthcli.cli.arguments.provider import session_loader
    from depthcli.cli.screen.progress import drawn
    from depthcli.core.parallel.cores import usable_cores
    from depthcli.datasets.nyu import open_nyu
    from depthcli.evaluation.nyu import evaluate_nyu, plan_nyu
    from depthcli.evaluation.protocol import EvalProtocol
    from depthcli.evaluation.reports.text import cells, footnotes, to_text
    from depthcli.io.storage.atomic import write_text
    from depthcli.jobs.evaluate.models import open_models, open_prediction_folders
    from depthcli.jobs.evaluate.sheets import figures_of, positions_of, write_figures, write_page

    _check_options(models=model, no_model=no_model, per_image=per_image, as_json=as_json)
    if ids and not (figures or html):
        raise UsageError("--ids needs --figures DIR or --html FILE")
    detail = choose_detail(upsample, tile, None)
    task = plan_nyu(open_nyu(data), split, limit)
    positions = positions_of(task, ids)
    cores = usable_cores()
    at_once = workers or cores
    names: Sequence[str | None] = model or ([] if no_model or predictions else [None])
    share = threads or max(1, cores // at_once)
    if no_model and not predictions and not (trivial and task.split.train):
        raise UsageError(
            "nothing to compare: give --model or --predictions, or remove --no-model or "
            "--no-trivial (baselines need training pairs of the split)"
        )
    loaders = [session_loader(name, provider, share, provider_option) for name in names]
    predictors: list[Predictor] = [
        *open_models(loaders, detail),
        *open_prediction_folders(predictions or [], task, predictions_kind),
    ]
    protocol = EvalProtocol(
        averaging=average,
        crop=crop,
        mask=mask,
        compare_px=None if compare_at is None else (compare_at, compare_at),
        upsampling=upsample,
        tile_px=detail.tile_px,
        boundary=boundary,
    )
    with drawn(silent=quiet or as_json, announces=True) as progress:
        report = evaluate_nyu(
            task,
            predictors,
            protocol=protocol,
            alignments=align or [Alignment.NONE],
            trivial=trivial,
            per_image=per_image,
            progress=progress,
            workers=at_once,
        )
        sheets: tuple[Figure, ...] = ()
        if figures or html:
            titles = [Path(p.name).name for p in predictors]
            sheets = figures_of(task, positions, predictors, titles, progress)
    console.out(report.to_json() if as_json else to_text(report))
    if csv is not None:
        write_text(report.to_csv(), csv)
    if figures is not None:
        write_figures(sheets, figures, quiet=quiet or as_json)
    if html is not None:
        description = report.protocol.description
        write_page(html, report.title, description, cells(report), footnotes(report), sheets)


def _check_options(
    *, models: Sequence[str] | None, no_model: bool, per_image: bool, as_json: bool
) -> None:
    if models and no_model:
        raise UsageError("--model and --no-model exclude each other: give one of them")
    if per_image and not as_json:
        raise UsageError("--per-image is part of the JSON output: add --json")
