"""The implementation of ``depthcli eval nyu`` and ``depthcli eval pairs``."""

from collections.abc import Mapping, Sequence
from typing import Any

from depthcli.cli.arguments import evaluation
from depthcli.cli.arguments.detail import choose_detail
from depthcli.cli.arguments.provider import session_loader
from depthcli.cli.screen import console
from depthcli.cli.screen.evaluation import print_report
from depthcli.cli.screen.progress import show_progress
from depthcli.core.parallel.cores import share_cores
from depthcli.datasets.splits import SplitName
from depthcli.errors import UsageError
from depthcli.evaluation.protocol import HEADLINE, EvalProtocol
from depthcli.evaluation.reports.text import report_page
from depthcli.evaluation.table import EvalOptions
from depthcli.jobs.evaluate.files import EvaluationFiles
from depthcli.jobs.evaluate.models import ModelsRequest, compare_models
from depthcli.metrics.choices import Alignment


def compare(
    given: Mapping[str, Any], split: SplitName | None, models: Sequence[str | None]
) -> None:
    """Compare models, and predictions of other tools, and print the table.

    Args:
        given: the values of the command's parameters by name.
        split: of NYU Depth v2; None for all pairs of a custom data set.
        models: their names; None for the bundled model.
    """
    as_json, is_silent = given["as_json"], given["quiet"] or given["as_json"]
    if given["per_image"] and not as_json:
        raise UsageError("--per-image is part of the JSON output: add --json")
    if not models and (given["tile"] is not None or given["upsample"] != HEADLINE.upsampling):
        raise UsageError("--upsample and --tile are for models, and none is compared: remove them")
    files = EvaluationFiles(given["csv"], given["figures"], given["html"])
    files.check((given["data"], *(given["predictions"] or ()), *models))
    workers, threads = share_cores(given["workers"], given["threads"])
    runner = (given["provider"], threads, given["provider_option"])
    request = ModelsRequest(
        given["data"],
        models=tuple(session_loader(name, *runner) for name in models),
        predictions=tuple(given["predictions"] or ()),
        predictions_kind=evaluation.parse_kind(given["predictions_kind"]),
        predictions_scale=given["predictions_scale"],
        units_per_metre=given.get("png_scale"),
        split=split,
        limit=given["limit"],
        options=EvalOptions(
            _protocol(given, split),
            alignments=tuple(given["align"] or (Alignment.NONE,)),
            trivial=given.get("trivial", False),
            per_image=given["per_image"],
            workers=workers,
        ),
        against=given["against"],
        shown_ids=evaluation.shown_ids(given["ids"], given["figures"], given["html"]),
    )
    with show_progress(silent=is_silent, announce=True) as progress:
        done = compare_models(request, progress, console.warn)
    print_report(
        done.report, report_page(done.report), done.figures, files, as_json=as_json, quiet=is_silent
    )


def _protocol(given: Mapping[str, Any], split: SplitName | None) -> EvalProtocol:
    size = given["compare_at"]
    return EvalProtocol(
        averaging=given["average"],
        crop=given.get("crop", HEADLINE.crop),
        mask=given.get("mask", HEADLINE.mask),
        compare_px=None if size is None else (size, size),
        upsampling=given["upsample"],
        tile_px=choose_detail(given["upsample"], given["tile"]).tile_px,
        full_size_px=None if split is None else HEADLINE.full_size_px,
        max_m=given.get("max_depth", HEADLINE.max_m),
        boundary=given["boundary"],
    )
