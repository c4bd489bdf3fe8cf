"""``depthcli eval runs``: the table of training runs."""

from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli.arguments import evaluation, options
from depthcli.cli.screen import console
from depthcli.core.choices import Weights
from depthcli.core.extras import INSTALL_TRAIN
from depthcli.datasets.splits import SplitName
from depthcli.errors import DepthcliError, ExitCode
from depthcli.metrics.choices import Alignment


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
    align: evaluation.AlignOption = None,
    weights: options.WeightsOption = Weights.AVERAGED,
    trivial: evaluation.TrivialOption = True,
    published: Annotated[bool, typer.Option(help="Include the paper's rows.")] = True,
    against: Annotated[
        str | None,
        typer.Option(
            metavar="ROW",
            help="Also compare this trained row with every other: paired bootstrap over scenes.",
        ),
    ] = None,
    limit: evaluation.LimitOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="Inference threads.")] = None,
    figures: evaluation.FiguresOption = None,
    ids: evaluation.IdsOption = None,
    html: evaluation.HtmlOption = None,
    csv: evaluation.CsvOption = None,
    as_json: evaluation.JsonOption = False,
    quiet: evaluation.QuietOption = False,
) -> int:
    """Compare training runs on images that none of them was trained on.

    Runs whose folders differ only in -seedK are one row: mean and standard deviation.
    """
    from depthcli.cli.arguments.provider import session_loader
    from depthcli.cli.screen.evaluation import print_report
    from depthcli.cli.screen.progress import show_progress
    from depthcli.core.parallel.cores import usable_cores
    from depthcli.evaluation.reports.runs_text import runs_page
    from depthcli.evaluation.table import EvalOptions
    from depthcli.jobs.evaluate.files import EvaluationFiles

    shown_ids = evaluation.shown_ids(ids, figures, html)
    try:
        from depthcli.jobs.evaluate.runs import RunsRequest, compare_runs
    except ImportError as error:
        raise DepthcliError(f"reading checkpoints needs {error.name}: {INSTALL_TRAIN}") from error
    files = EvaluationFiles(csv, figures, html)
    files.check((folder, data))
    request = RunsRequest(
        folder,
        data,
        split=split,
        limit=limit,
        weights=weights,
        options=EvalOptions(
            alignments=tuple(align or (Alignment.NONE,)), trivial=trivial, workers=usable_cores()
        ),
        published=published,
        against=against,
        runner=session_loader(None, provider, threads, provider_option),
        shown_ids=shown_ids,
    )
    with show_progress(silent=quiet or as_json, announce=True) as progress:
        done = compare_runs(request, progress, console.warn)
    page = runs_page(done.report)
    print_report(done.report, page, done.figures, files, as_json=as_json, quiet=quiet)
    if done.failed:
        count = "1 run is" if len(done.failed) == 1 else f"{len(done.failed)} runs are"
        console.error(f"{count} skipped: {'; '.join(done.failed)}")
    return ExitCode.SOME_FAILED if done.failed else ExitCode.OK
