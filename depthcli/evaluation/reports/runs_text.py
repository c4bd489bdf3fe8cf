"""The table of training runs as text."""

import math
from collections.abc import Sequence

from depthcli.core.text import one_line
from depthcli.evaluation.differences import Interval
from depthcli.evaluation.reports.text import Page, model_checksums
from depthcli.evaluation.runs_report import RunsReport, RunsRow, Training
from depthcli.metrics.accumulate import Scores
from depthcli.metrics.depth import METRICS

_METRICS = ("abs_rel", "rmse", "rms_log", "log10", "d1", "d2", "d3")
"""The columns of the paper's Table I; JSON and CSV have all metrics."""
_FACTS = ("paired", "seeds", "epochs", "steps", "minutes", "params", "ms")


def runs_page(report: RunsReport) -> Page:
    """The text of a report."""
    header = ["row", "align", *_FACTS, "images", *_METRICS]
    table = [header, *(_run_cells(line) for line in report.rows)]
    marked = [f"* {line.row.note}" for line in report.rows if line.row.note]
    differences = None
    if report.differences:
        name = one_line(report.differences[0].name)
        title = f"{name} minus each row, 95 % interval over scenes; ! excludes 0"
        differences = title, _difference_cells(report)
    return Page(
        report.title,
        report.protocol.description,
        table,
        [
            "higher is better for d1, d2, d3, lower for the others; rmse in metres",
            *marked,
            *report.notes,
        ],
        differences,
        model_checksums(run for line in report.rows for run in line.runs or (line.row,)),
    )


def _difference_cells(report: RunsReport) -> list[list[str]]:
    """The differences from one row as text, header first."""
    lines = [["minus", "align", *_METRICS]]
    for difference in report.differences:
        intervals = dict(zip(METRICS, difference.intervals, strict=True))
        shown = [_interval(intervals[metric]) for metric in _METRICS]
        lines.append([one_line(difference.other), difference.alignment or "-", *shown])
    return lines


def _interval(interval: Interval) -> str:
    if math.isnan(interval.mean):
        return "-"
    clear = "!" if interval.is_significant else ""
    return f"{interval.mean:+.4f}{clear} [{interval.low:+.3f},{interval.high:+.3f}]"


def _run_cells(line: RunsRow) -> list[str]:
    row = line.row
    name = one_line(row.name) + ("*" if row.note else "")
    scores = [_score_cell(metric, row.scores, line.std) for metric in _METRICS]
    return [
        name,
        row.alignment or "-",
        *_training_cells(line.training),
        str(row.image_count),
        *scores,
    ]


def _score_cell(metric: str, mean: Scores, std: Scores | None) -> str:
    if math.isnan(mean[metric]):
        return "-"
    return f"{mean[metric]:.4f}" + (f"±{std[metric]:.4f}" if std else "")


def _training_cells(training: Training | None) -> list[str]:
    if training is None:
        return ["-"] * len(_FACTS)
    return [
        "yes" if training.paired else "no",
        str(len(training.seeds)),
        f"{_min_to_max(training.epochs)}/{training.epochs_planned}",
        _min_to_max(training.steps),
        f"{sum(training.minutes) / len(training.minutes):.1f}",
        f"{training.parameters / 1e6:.2f}M",
        f"{training.latency_ms:.1f}",
    ]


def _min_to_max(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return str(low) if low == high else f"{low}-{high}"
