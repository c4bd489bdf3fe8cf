"""Table I of trained runs, and the same as JSON and CSV."""

import csv
import io
import json
import math
from dataclasses import dataclass
from typing import Any

from depthcli.datasets.splits import SplitName
from depthcli.evaluation.differences import Difference
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.evaluation.report import ReportRow, protocol_json, row_json, scores_json
from depthcli.metrics.accumulate import Scores
from depthcli.metrics.depth import METRICS

_FACTS = ("paired", "seeds", "epochs", "epochs_planned", "steps", "minutes", "parameters", "ms")


@dataclass(frozen=True, slots=True)
class Training:
    """How a row came to be; a tuple has an entry per seed."""

    seeds: tuple[int, ...]  #: of the runs
    paired: bool  #: whether pictures and depth maps of one scene point were shown together
    parameters: int  #: weights of the generator
    #: mean over the seeds of the median time of the network alone for one picture
    latency_ms: float
    epochs: tuple[int, ...]  #: done
    epochs_planned: int  #: of the whole schedule
    steps: tuple[int, ...]  #: optimisation steps done
    minutes: tuple[float, ...]  #: of training


@dataclass(frozen=True, slots=True)
class RunsRow:
    """One line of the table."""

    row: ReportRow  #: name, source, alignment, number of images and mean scores
    #: sample standard deviation over the seeds; None for fewer than two
    spread: Scores | None = None
    training: Training | None = None  #: how it came to be; None if nothing was trained here
    runs: tuple[ReportRow, ...] = ()  #: the rows of the seeds


@dataclass(frozen=True, slots=True)
class RunsReport:
    """Table I of trained runs."""

    #: which division of NYU Depth v2; ``val`` is what the runs themselves held out
    split: SplitName
    image_count: int  #: test images that were compared
    split_count: int  #: test images that the split has
    train_count: int  #: training pairs behind the trivial rows
    protocol: EvalProtocol  #: how prediction and truth were compared
    rows: tuple[RunsRow, ...]  #: the lines
    notes: tuple[str, ...] = ()  #: what a reader has to know besides
    differences: tuple[Difference, ...] = ()  #: of one row from every other, if they were asked for

    @property
    def title(self) -> str:
        """Data set, split, number of images and protocol in one line."""
        which = "scenes that the runs held out" if self.split is SplitName.VAL else self.split
        count = f"{self.image_count} images"
        if self.image_count != self.split_count:
            count = f"{self.image_count} of {self.split_count} images"
        return f"NYU Depth v2 · {which}, {count} · {self.protocol.name} protocol"

    def to_json(self) -> str:
        """The report as JSON; values that do not exist are null."""
        document = {
            "schema": 1,
            "dataset": "NYU Depth v2",
            "split": {
                "name": self.split,
                "images": self.image_count,
                "images_of_complete_split": self.split_count,
                "training_pairs_of_trivial_rows": self.train_count,
            },
            "protocol": protocol_json(self.protocol),
            "rows": [_row(row) for row in self.rows],
            "notes": self.notes,
        }
        if self.differences:
            document["differences"] = [_difference(difference) for difference in self.differences]
        return json.dumps(document, indent=2)

    def to_csv(self) -> str:
        """One line per row: what it is, what it cost, then mean and deviation of every metric."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        origin = ["name", "source", "align", "split", "images", "protocol"]
        writer.writerow([*origin, *_FACTS, *METRICS, *(f"{metric}_sd" for metric in METRICS)])
        for line in self.rows:
            row = line.row
            writer.writerow(
                [
                    *(row.name, row.source, row.alignment or "", self.split),
                    *(row.image_count, self.protocol.name),
                    *_facts(line.training),
                    *_values(row.scores),
                    *(_values(line.spread) if line.spread else [""] * len(METRICS)),
                ]
            )
        return text.getvalue()


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
