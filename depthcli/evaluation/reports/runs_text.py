"""The table of training runs as text."""

import math
from collections.abc import Sequence

from depthcli.core.text import one_line
from depthcli.evaluation.reports.differences_text import differences_table
from depthcli.evaluation.reports.text import Page, model_checksums
from depthcli.evaluation.runs_report import RunsReport, RunsRow, Training
from depthcli.metrics.accumulate import Scores

_METRICS = ("abs_rel", "rmse", "rms_log", "log10", "d1", "d2", "d3")
"""The columns of the paper's Table I; JSON and CSV have all metrics."""
_FACTS = ("paired", "seeds", "epochs", "steps", "minutes", "params", "ms")


def runs_page(report: RunsReport) -> Page:
    """The text of a report."""
    header = ["row", "align", *_FACTS, "images", *_METRICS]
    table = [header, *(_run_cells(line) for line in report.rows)]
    marked = [f"* {line.row.note}" for line in report.rows if line.row.note]
    return Page(
        report.title,
        report.protocol.description,
        table,
        [
            "higher is better for d1, d2, d3, lower for the others; rmse in metres",
            *marked,
            *report.notes,
        ],
        differences_table(report.differences, _METRICS),
        model_checksums(run for line in report.rows for run in line.runs or (line.row,)),
    )


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
