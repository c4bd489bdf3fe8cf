"""``depthcli eval``: comparing models, predictions of other tools and training runs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from depthcli.cli import options as groups, parse
from depthcli.cli.groups import group
from depthcli.cli.screen import console
from depthcli.core import options as choices
from depthcli.errors import ExitCode, UsageError
from depthcli.lab.commands.options import PatternOptions, WeightsOption
from depthcli.lab.options import Alignment, Averaging, Crop, Mask, Part, SplitName, Weights

if TYPE_CHECKING:
    from depthcli.lab.evaluation.protocol import EvalProtocol
    from depthcli.lab.jobs.evaluate import EvalRequest, EvalResult, ReportFiles


@group
class ProtocolDetail(groups.DetailOptions):
    """Metrics."""

    upsample: choices.Upsampling | None = groups.option(  # type: ignore[assignment]
        "Upsampling of the models' depth: bilinear as in the protocol (default), or guided as in "
        "predict (default with --boundary)."
    )


@group
class ModelOptions:
    """Metrics."""

    model: list[str] | None = groups.usual(
        "Name or path of a model; repeatable. Default: the bundled model.",
        "--model",
        metavar="MODEL",
        autocompletion=groups.models,
    )
    predictions: list[Path] | None = groups.usual(
        "Folder with predictions of another tool, named by id or as the images; repeatable.",
        metavar="DIR",
    )
    predictions_kind: choices.DepthEncoding | None = groups.option(
        "What --predictions hold, if the files do not state it: metric (default), distance (along "
        "the ray), relative, inverse, or disparity (with --baseline)."
    )
    baseline: float | None = groups.option(
        "Metres between the two cameras, for disparity in --predictions or, in 'pairs', as depth.",
        callback=groups.positive,
    )
    predictions_scale: float | None = groups.option(
        "Units per metre of --predictions in integers, if the files do not state it: 1000 "
        "(default, millimetres), 256 (KITTI).",
        callback=groups.png_scale_range,
    )
    detail: ProtocolDetail
    workers: groups.WorkersOption = None
    prompt: str | None = groups.option(
        "Known depth for the models, drawn from the truth: uniform:500 (points), lidar:4 (lines), "
        "camera:64 (columns) or corners:200; with ,noise=0.02 or ,wrong=0.25 (shares).",
        metavar="PATTERN",
    )
    anchors_fit: choices.DepthFit | None = groups.option("Fit to --prompt, as in 'predict'.")
    average: Averaging = groups.option(
        "Average over images, or over all pixels.", default=Averaging.IMAGE
    )
    compare_at: int | None = groups.option(
        "Resize prediction and ground truth to N×N first (for example 256).",
        metavar="N",
        min=1,
        max=20_000,
    )
    boundary: bool = groups.option(
        "Also compute boundary metrics: dbe_acc, dbe_comp, edge_f1.", default=False
    )
    per_image: bool = groups.option(
        "With --json, also print the scores of each image.", default=False
    )

    @property
    def names(self) -> Sequence[str | None]:
        """Names of the models; None for the bundled one, if nothing else is compared."""
        return self.model or ([] if self.predictions else [None])


@group
class ReportOptions:
    """Table and figures."""

    csv: Path | None = groups.option("Also write the table as CSV.", metavar="FILE")
    html: Path | None = groups.option("Write table and figures to one HTML file.", metavar="FILE")
    screen: groups.ScreenOptions

    def files(self, figures: Path | None = None) -> "ReportFiles":
        """The files to write, which are checked."""
        from depthcli.lab.jobs.evaluate import ReportFiles

        return ReportFiles(self.csv, figures, self.html).checked()

    def show(self, done: "EvalResult", files: "ReportFiles") -> None:
        """Print the table, and write the files."""
        from depthcli.lab.evaluation.page import report_page

        page = report_page(done.report)
        if self.screen.as_json:
            console.out(done.report.to_json())
        elif not self.screen.quiet:
            console.out(page.to_text())
        for path in files.write(page, done.report.to_csv(), done.figures):
            if self.screen.shows_text:
                console.note(str(path))


@group
class TableOptions:
    """Table and figures."""

    align: list[Alignment] | None = groups.usual(
        "Alignment to ground truth per image: none (default), median (scale), depth or disparity "
        "(least-squares scale and shift); repeatable, one row each."
    )
    against: str | None = groups.usual(
        "Also compare this row with every other: paired bootstrap over scenes.", metavar="ROW"
    )
    by: list[Part] | None = groups.option(
        "Also score pixels by true distance, images by kind of scene, or the worst; repeatable."
    )
    limit: int | None = groups.option(
        "Evaluate only N images, spread evenly over the split.",
        "--limit",
        "--images",
        metavar="N",
        min=1,
    )
    runtime: groups.RuntimeOptions
    figures: Path | None = groups.option(
        "Write figures of sample images, in gray and in colour.", metavar="DIR"
    )
    ids: str | None = groups.option("Image ids to show in the figures.", metavar="A,B")
    metric: list[str] | None = groups.option(
        "A further metric: mae, imae, irmse, d105, d110, or your own function of true and "
        "predicted metres; repeatable.",
        metavar="NAME|MODULE:NAME",
    )
    report: ReportOptions

    def request(self, data: Path, options: Mapping[str, Any], **fields: Any) -> "EvalRequest":  # noqa: ANN401
        """The request for this table, with further ``fields``, and ``options`` of the table."""
        from depthcli.lab.evaluation.evaluate import EvalOptions
        from depthcli.lab.jobs.evaluate import EvalRequest

        alignments, parts = tuple(self.align or (Alignment.NONE,)), tuple(self.by or ())
        table = EvalOptions(alignments=alignments, against=self.against, parts=parts, **options)
        names = (name.strip() for name in (self.ids or "").split(","))
        has_figures = self.figures or self.report.html
        ids = tuple(filter(None, names)) if has_figures else None
        return EvalRequest(data, limit=self.limit, options=table, shown_ids=ids, **fields)


_TrivialOption = Annotated[bool, typer.Option(help="Include baselines that ignore the image.")]
_LimitOption = Annotated[
    float,
    typer.Option(
        metavar="METRES",
        callback=groups.positive,
        help="Range of depth that counts, to which predictions are clamped.",
    ),
]


def nyu(
    *,
    data: Path = typer.Option(
        ...,
        envvar="DEPTHCLI_NYU",
        help=".mat file, or a folder with it or rgb/, depth/, index.csv.",
    ),
    models: ModelOptions,
    no_model: bool = typer.Option(False, "--no-model", help="Do not evaluate the bundled model."),
    split: SplitName = typer.Option(
        SplitName.PAPER,
        help="paper: 1-1000 train, 1001-1449 test. official: 795/654. val: scenes of 1-1000.",
    ),
    crop: Crop = typer.Option(
        Crop.NONE, help="eigen: rows 45:471, columns 41:601. s2d: 304×228 of 320×240."
    ),
    mask: Mask = typer.Option(Mask.FILLED, help="raw: only where the sensor measured depth."),
    trivial: _TrivialOption = True,
    table: TableOptions,
) -> int:
    """Evaluate depth metrics on NYU Depth v2."""
    from depthcli.lab.evaluation.protocol import EvalProtocol

    if models.model and no_model:
        raise UsageError("", "give {model} or {no_model}, not both")
    protocol = EvalProtocol(crop=crop, mask=mask)
    names = (models.model or []) if no_model else models.names
    return _run(_request(data, names, models, table, protocol, trivial=trivial, split=split), table)


def pairs(
    data: Path = typer.Argument(
        ...,
        metavar="DIR",
        help="Folder with rgb/ and depth/, or in the layout of TUM RGB-D, ScanNet, 7-Scenes, "
        "3DMatch or KITTI; cameras.csv in it (id,focal_px) states focal lengths. Or a list.txt.",
    ),
    *,
    names: PatternOptions,
    models: ModelOptions,
    png_scale: float | None = typer.Option(
        None,
        callback=groups.png_scale_range,
        help="Units per metre of the depth files: 256 in KITTI, 5000 in TUM, 4000 in Matterport. "
        "Default: as files or layout state, else 1000 for integers and 1 for floats.",
    ),
    depth_kind: choices.DepthEncoding = typer.Option(
        choices.DepthEncoding.METRIC,
        help="Meaning of the depth files: metric (along the axis), distance (along the ray), "
        "disparity (with --baseline) or inverse (with --png-scale).",
    ),
    min_depth: _LimitOption = 0.001,
    max_depth: _LimitOption = 10.0,
    crop: Crop = typer.Option(Crop.NONE, help="Part to compare: garg in KITTI, eigen in NYU."),
    table: TableOptions,
) -> int:
    """Evaluate depth metrics on images and depth of your own.

    Metric models are rescaled to the focal length of each image, where it is known.
    """
    from depthcli.io.stored.depth import DepthReadOptions
    from depthcli.lab.evaluation.protocol import EvalProtocol

    if min_depth >= max_depth:
        raise UsageError(f"it is not below {max_depth:g} m", option="min_depth")
    protocol = EvalProtocol(full_size_px=None, crop=crop, min_m=min_depth, max_m=max_depth)
    truth = DepthReadOptions(png_scale, depth_kind, baseline_m=models.baseline)
    files = partial(_request, truth=truth, patterns=names.patterns, split=None)
    return _run(files(data, models.names, models, table, protocol), table)


def runs(
    folder: Path = typer.Argument(..., metavar="RUNS", help="The --out folder of depthcli train."),
    *,
    data: Path = typer.Option(
        ..., envvar="DEPTHCLI_NYU", help="NYU Depth v2 or the folder that the runs were trained on."
    ),
    names: PatternOptions,
    split: SplitName = typer.Option(
        SplitName.VAL,
        help="val: scenes held out by the runs. paper, official: test images, if new to all runs.",
    ),
    weights: WeightsOption = Weights.AVERAGED,
    trivial: _TrivialOption = True,
    published: bool = typer.Option(True, help="Include the paper's rows."),
    table: TableOptions,
) -> int:
    """Compare training runs on images that none of them was trained on.

    Runs whose folders differ only in -seedK are one row: mean and standard deviation.
    """
    from depthcli.core.parallel import usable_cores

    request = table.request(
        data,
        {"trivial": trivial, "published": published, "workers": usable_cores()},
        runs=folder,
        weights=weights,
        runner=parse.session_loader(None, table.runtime),
        patterns=names.patterns,
        split=split,
    )
    return _run(request, table)


def compare(
    first: Path = typer.Argument(..., metavar="A.json", help="A report of eval --json."),
    second: Path = typer.Argument(..., metavar="B.json", help="Another one, of the same data."),
    *,
    tolerance: float | None = typer.Option(
        None,
        callback=groups.positive,
        metavar="SHARE",
        help="State whether A is consistent with B: the intervals of all differences are within "
        "this share of B's scores. Exit code 1 if not.",
    ),
    report: ReportOptions,
) -> int:
    """Compare two reports that were kept, paired where they have scores of the same images."""
    from depthcli.lab.evaluation.saved import check_consistency, compare_reports
    from depthcli.lab.jobs.evaluate import EvalResult

    files, table, is_consistent = report.files(), compare_reports(first, second), True
    if tolerance is not None:
        table, is_consistent = check_consistency(table, tolerance)
    report.show(EvalResult(table), files)
    return ExitCode.OK if is_consistent else ExitCode.SOME_FAILED


def _request(
    data: Path,
    names: Sequence[str | None],
    models: ModelOptions,
    table: TableOptions,
    protocol: "EvalProtocol",
    *,
    trivial: bool = False,
    **fields: Any,  # noqa: ANN401 - fields of EvalRequest
) -> "EvalRequest":
    from depthcli.core.parallel import share_cores
    from depthcli.io.stored.depth import DepthReadOptions
    from depthcli.lab.datasets.prompts import parsed_prompt

    if models.per_image and not table.report.screen.as_json:
        raise UsageError("scores of each image are part of the JSON output", "add {json}")
    if models.anchors_fit and not models.prompt:
        raise UsageError("", "{anchors_fit} is for {prompt}: give both or neither")
    kind, baseline_m = models.predictions_kind, models.baseline
    if kind is choices.DepthEncoding.DISPARITY and baseline_m is None:
        message = "disparity up to a factor is inverse"
        raise UsageError(message, "give {baseline}, or inverse", option="predictions_kind")
    if kind is not choices.DepthEncoding.DISPARITY:
        baseline_m = None
    workers, threads = share_cores(models.workers, table.runtime.threads)
    size_px = models.compare_at
    usual = choices.Upsampling.GUIDED if models.boundary else choices.Upsampling.BILINEAR
    upsampling = models.detail.upsample or usual
    detail = replace(models.detail, upsample=upsampling)
    protocol = replace(
        protocol,
        averaging=models.average,
        compare_px=None if size_px is None else (size_px, size_px),
        upsampling=upsampling,
        tile_px=parse.detail(detail).tile_px,
        boundary=models.boundary,
    )
    options = {"trivial": trivial, "per_image": models.per_image, "workers": workers}
    scale = models.predictions_scale
    return table.request(
        data,
        options | {"protocol": protocol},
        models=tuple(parse.session_loader(name, table.runtime, threads) for name in names),
        predictions=tuple(models.predictions or ()),
        predictions_reading=DepthReadOptions(None, kind, scale, baseline_m=baseline_m),
        prompt=parsed_prompt(models.prompt) if models.prompt else None,
        anchors_fit=models.anchors_fit,
        **fields,
    )


def _run(request: "EvalRequest", table: TableOptions) -> int:
    from depthcli.lab.jobs.evaluate import run_evaluation
    from depthcli.lab.metrics.depth import METRICS, OPTIONAL, add_metric
    from depthcli.lab.training.plugins import imported

    for name in table.metric or ():
        if name in OPTIONAL:
            METRICS[name] = OPTIONAL[name]
        else:
            add_metric(name.rpartition(":")[2], imported(name))
    screen, files = table.report.screen, table.report.files(table.figures)
    with screen.show_progress() as progress:
        warn = console.warn if not screen.quiet else lambda _text: None
        done = run_evaluation(request, progress, warn)
    table.report.show(done, files)
    if done.failed:
        count = "1 run is" if len(done.failed) == 1 else f"{len(done.failed)} runs are"
        console.error(f"{count} skipped: {'; '.join(done.failed)}")
    return ExitCode.SOME_FAILED if done.failed else ExitCode.OK


COMMANDS = {"nyu": nyu, "pairs": pairs, "runs": runs, "compare": compare}
