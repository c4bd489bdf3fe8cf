"""``depthcli eval runs``: Table I of the runs that ``depthcli train`` made."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import options
from depthcli.cli.screen import console
from depthcli.core.choices import Detail, Upsampling, Weights
from depthcli.core.extras import INSTALL_TRAIN
from depthcli.datasets.splits import SplitName
from depthcli.errors import DepthcliError, ExitCode, UsageError
from depthcli.metrics.choices import Alignment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.core.progress import Progress
    from depthcli.evaluation.reports.figures import Figure
    from depthcli.evaluation.trained import TrainedModel
    from depthcli.export.trained import TrainedRun


def runs(
    *,
    folder: Annotated[
        Path, typer.Argument(metavar="RUNS", help="The --out folder of depthcli train.")
    ],
    data: Annotated[
        Path,
        typer.Option(envvar="DEPTHCLI_NYU", help="NYU Depth v2, which the runs were trained on."),
    ],
    split: Annotated[
        SplitName,
        typer.Option(
            help="val: scenes held out by the runs. paper, official: test part of the split, if "
            "no run was trained on it."
        ),
    ] = SplitName.VAL,
    align: Annotated[
        list[Alignment] | None,
        typer.Option(
            help="Alignment to ground truth per image: none, median, depth or disparity; "
            "repeatable, one row each. Default: none."
        ),
    ] = None,
    weights: Annotated[
        Weights,
        typer.Option(help="averaged: the moving average, of runs that keep one; raw: without it."),
    ] = Weights.AVERAGED,
    trivial: Annotated[
        bool, typer.Option(help="Include baselines that ignore the picture.")
    ] = True,
    published: Annotated[bool, typer.Option(help="Include the paper's rows.")] = True,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="ROW",
            help="Also compare this trained row with every other: paired bootstrap over scenes.",
        ),
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, help="Evaluate only N images, spread evenly over the split."
        ),
    ] = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Inference threads.")] = None,
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
    csv: Annotated[Path | None, typer.Option(help="Also write the table as CSV.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Do not show progress.")] = False,
) -> int:
    """Compare training runs on pictures that none of them was trained on.

    Runs whose folders differ only in -seedK are one row: mean and standard deviation.
    """
    from depthcli.cli.screen.progress import drawn
    from depthcli.core.parallel.cores import usable_cores
    from depthcli.datasets.nyu import open_nyu
    from depthcli.evaluation.reports.runs_report import to_csv, to_json
    from depthcli.evaluation.reports.runs_text import cells, notes, to_text
    from depthcli.evaluation.runs_table import evaluate_runs
    from depthcli.evaluation.trained import grouped, plan_comparison
    from depthcli.io.storage.atomic import write_text
    from depthcli.jobs.evaluate.sheets import figures_of, positions_of, write_figures, write_page

    if ids and not (figures or html):
        raise UsageError("--ids needs --figures DIR or --html FILE")
    dataset = open_nyu(data)
    opened, failed = _open_runs(folder)
    task = plan_comparison(dataset, opened, split, limit)
    positions = positions_of(task, ids)
    names = grouped(opened)  # refuses what is no seed of a row before anything is exported
    if against is not None and against not in names:
        raise UsageError(f"--against {against} is no row; choose from {', '.join(names)}")
    quiet = quiet or as_json
    with tempfile.TemporaryDirectory() as spare, drawn(silent=quiet, announces=True) as progress:
        exported = _exported(opened, Path(spare), weights, progress, failed)
        models = _loaded(exported, provider, provider_option or (), threads)
        report = evaluate_runs(
            task,
            models,
            alignments=align or [Alignment.NONE],
            trivial=trivial,
            published=published,
            progress=progress,
            workers=usable_cores(),
            weights=weights,
            against=against,
        )
        sheets: tuple[Figure, ...] = ()
        if figures or html:
            shown = list(dict.fromkeys(line.row.name for line in report.rows if line.runs))
            groups = grouped([model.run for model in models])
            by_run = {model.run.name: model.predictor for model in models}
            firsts = [by_run[groups[name][0].name] for name in shown]
            sheets = figures_of(task, positions, firsts, shown, progress)
    console.out(to_json(report) if as_json else to_text(report))
    if csv is not None:
        write_text(to_csv(report), csv)
    if figures is not None:
        write_figures(sheets, figures, quiet=quiet)
    if html is not None:
        description = report.protocol.description
        write_page(html, report.title, description, cells(report), notes(report), sheets)
    if failed:
        console.error(f"{len(failed)} runs are skipped: {'; '.join(failed)}")
    return ExitCode.SOME_FAILED if failed else ExitCode.OK


def _open_runs(folder: Path) -> tuple[list[TrainedRun], list[str]]:
    """The runs that can be used, and why others cannot.

    Raises:
        DepthcliError: none can.
    """
    try:
        from depthcli.export.trained import find_runs, open_run
    except ImportError as error:
        raise DepthcliError(f"reading checkpoints needs {error.name}: {INSTALL_TRAIN}") from error
    opened, failed = [], []
    for run in find_runs(folder):
        try:
            opened.append(open_run(run))
        except DepthcliError as error:
            failed.append(f"{run.name} ({error})")
    if not opened:
        raise DepthcliError(f"no run of {folder} can be used: {'; '.join(failed)}")
    return opened, failed


def _exported(
    opened: Sequence[TrainedRun],
    spare: Path,
    weights: Weights,
    progress: Progress,
    failed: list[str],
) -> list[tuple[TrainedRun, Path]]:
    """Every run with its model; those that cannot be exported join ``failed``.

    Raises:
        DepthcliError: none can.
    """
    from depthcli.export.trained import export_run

    advance, exported = progress.begin("exporting runs", len(opened)), []
    for run in opened:
        try:
            exported.append((run, export_run(run, spare, weights)))
        except DepthcliError as error:
            failed.append(f"{run.name} ({error})")
        advance(1)
    if not exported:
        raise DepthcliError(f"no run can be exported: {'; '.join(failed)}")
    return exported


def _loaded(
    exported: Sequence[tuple[TrainedRun, Path]],
    provider: str,
    settings: Sequence[str],
    threads: int | None,
) -> list[TrainedModel]:
    """Every run with its model, ready to predict, and the time that it takes."""
    from depthcli.cli.arguments.provider import session_loader
    from depthcli.evaluation.trained import TrainedModel
    from depthcli.inference.latency import measure_ms
    from depthcli.jobs.evaluate.models import open_models

    loaders = [session_loader(str(path), provider, threads, settings) for _, path in exported]
    # The headline protocol resizes bilinearly: what is compared is the network alone.
    opened = open_models(loaders, Detail(Upsampling.BILINEAR))
    times_ms = measure_ms([model.pipeline for model in opened])
    rows = zip(exported, opened, times_ms, strict=True)
    return [TrainedModel(run, replace(model, name=run.name), ms) for (run, _), model, ms in rows]
