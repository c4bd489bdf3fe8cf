"""The table of trained runs as JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
import math
from typing import TYPE_CHECKING, Any

from depthcli.evaluation.report import protocol_json, row_json, scores_json
from depthcli.metrics.depth import METRICS

if TYPE_CHECKING:
    from depthcli.evaluation.differences import Difference
    from depthcli.evaluation.runs_table import RunsReport, RunsRow, Training
    from depthcli.metrics.accumulate import Scores

_FACTS = ("paired", "seeds", "epochs", "epochs_planned", "steps", "minutes", "parameters", "ms")


def to_json(report: RunsReport) -> str:
    """The report as JSON; values that do not exist are null."""
    document = {
        "schema": 1,
        "dataset": "NYU Depth v2",
        "split": {
            "name": report.split,
            "images": report.image_count,
            "images_of_complete_split": report.split_count,
            "training_pairs_of_trivial_rows": report.train_count,
        },
        "protocol": protocol_json(report.protocol),
        "rows": [_row(row) for row in report.rows],
        "notes": report.notes,
    }
    if report.differences:
        document["differences"] = [_difference(difference) for difference in report.differences]
    return json.dumps(document, indent=2)


def _row(line: RunsRow) -> dict[str, Any]:
    entry = row_json(line.row)
    if line.training is not None:
        spread = line.spread
        entry["standard_deviation"] = None if spread is None else scores_json(spread)
        entry["training"] = _training(line.training)
        entry["runs"] = [row_json(row) for row in line.runs]
    return entry


def _difference(difference: Difference) -> dict[str, Any]:
    return {
        "row": difference.name,
        "minus": difference.other,
        "align": difference.alignment,
        "intervals": {
            metric: {
                "mean": _or_none(interval.mean),
                "low": _or_none(interval.low),
                "high": _or_none(interval.high),
            }
            for metric, interval in zip(METRICS, difference.intervals, strict=True)
        },
    }


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def _training(training: Training) -> dict[str, Any]:
    return {
        "seeds": training.seeds,
        "paired": training.paired,
        "parameters": training.parameters,
        "latency_ms": round(training.latency_ms, 3),
        "epochs": training.epochs,
        "epochs_planned": training.epochs_planned,
        "steps": training.steps,
        "minutes": [round(minutes, 4) for minutes in training.minutes],
    }


def to_csv(report: RunsReport) -> str:
    """One line per row: what it is, what it cost, then mean and deviation of every metric."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    origin = ["name", "source", "align", "split", "images", "protocol"]
    writer.writerow([*origin, *_FACTS, *METRICS, *(f"{metric}_sd" for metric in METRICS)])
    for line in report.rows:
        row = line.row
        writer.writerow(
            [
                *(row.name, row.source, row.alignment or "", report.split),
                *(row.image_count, report.protocol.name),
                *_facts(line.training),
                *_values(row.scores),
                *(_values(line.spread) if line.spread else [""] * len(METRICS)),
            ]
        )
    return text.getvalue()


def _facts(training: Training | None) -> list[str]:
    """In the order of ``_FACTS``; several seeds are separated by spaces."""
    if training is None:
        return [""] * len(_FACTS)
    return [
        "yes" if training.paired else "no",
        " ".join(map(str, training.seeds)),
        " ".join(map(str, training.epochs)),
        str(training.epochs_planned),
        " ".join(map(str, training.steps)),
        " ".join(f"{minutes:.2f}" for minutes in training.minutes),
        str(training.parameters),
        f"{training.latency_ms:.3f}",
    ]


def _values(scores: Scores) -> list[str]:
    return ["" if math.isnan(value) else repr(value) for value in scores.values]
