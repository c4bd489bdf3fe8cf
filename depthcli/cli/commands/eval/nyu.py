"""``depthcli eval nyu``: the table of metrics for models, files of other tools and trivial rows."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer reads the annotation
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import completion, evaluation, options
from depthcli.cli.screen import console
from depthcli.core.choices import Upsampling
from depthcli.datasets.splits import SplitName
from depthcli.errors import UsageError
from depthcli.evaluation.choices import Crop, Mask
from depthcli.metrics.choices import Alignment, Averaging

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.core.types import DepthKind


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
    trivial: evaluation.TrivialOption = True,
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
    limit: evaluation.LimitOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=1024, help="Images processed in parallel. Default: one per core."),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1, max=1024, help="Inference threads per worker. Default: cores / workers."
        ),
    ] = None,
    as_json: evaluation.JsonOption = False,
    per_image: Annotated[
        bool, typer.Option("--per-image", help="With --json, also print the scores of each image.")
    ] = False,
    csv: evaluation.CsvOption = None,
    figures: evaluation.FiguresOption = None,
    ids: evaluation.IdsOption = None,
    html: evaluation.HtmlOption = None,
    quiet: evaluation.QuietOption = False,
) -> None:
    """Evaluate depth metrics on NYU Depth v2."""
    from depthcli.cli.arguments.detail import choose_detail
    from depthcli.cli.arguments.provider import session_loader
    from depthcli.cli.screen.progress import drawn
    from depthcli.core.parallel.cores import usable_cores
    from depthcli.evaluation.nyu import EvalOptions
    from depthcli.evaluation.protocol import EvalProtocol
    from depthcli.evaluation.reports.text import report_page
    from depthcli.jobs.evaluate.files import EvaluationFiles
    from depthcli.jobs.evaluate.nyu import NyuRequest, compare_on_nyu

    _check_options(models=model, no_model=no_model, per_image=per_image, as_json=as_json)
    names: Sequence[str | None] = model or ([] if no_model or predictions else [None])
    at_once = workers or usable_cores()
    share = threads or max(1, usable_cores() // at_once)
    protocol = EvalProtocol(
        averaging=average,
        crop=crop,
        mask=mask,
        compare_px=None if compare_at is None else (compare_at, compare_at),
        upsampling=upsample,
        tile_px=choose_detail(upsample, tile, None).tile_px,
        boundary=boundary,
    )
    request = NyuRequest(
        data,
        models=tuple(session_loader(name, provider, share, provider_option) for name in names),
        predictions=tuple(predictions or ()),
        predictions_kind=_parse_kind(predictions_kind),
        split=split,
        limit=limit,
        options=EvalOptions(
            protocol,
            alignments=tuple(align or (Alignment.NONE,)),
            trivial=trivial,
            per_image=per_image,
            workers=at_once,
        ),
        shown_ids=evaluation.shown_ids(ids, figures, html),
    )
    with drawn(silent=quiet or as_json, announces=True) as progress:
        done = compare_on_nyu(request, progress, console.warn)
    page = report_page(done.report)
    console.out(done.report.to_json() if as_json else page.to_text())
    files = EvaluationFiles(csv, figures, html)
    for path in files.write(page, done.report.to_csv(), done.figures):
        if not (quiet or as_json):
            console.note(str(path))


def _check_options(
    *, models: Sequence[str] | None, no_model: bool, per_image: bool, as_json: bool
) -> None:
    if models and no_model:
        raise UsageError("--model and --no-model exclude each other: give one of them")
    if per_image and not as_json:
        raise UsageError("--per-image is part of the JSON output: add --json")


def _parse_kind(name: str | None) -> DepthKind | None:
    from depthcli.core.types import DepthKind

    if name not in {None, *DepthKind}:
        raise UsageError(f"--predictions-kind is {', '.join(DepthKind)}, not {name}")
    return None if name is None else DepthKind(name)
