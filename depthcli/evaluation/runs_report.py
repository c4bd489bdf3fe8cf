"""Table I of trained runs, and the same as JSON and CSV."""

from dataclasses import asdict, dataclass
from typing import Any

from depthcli.datasets.splits import SplitName
from depthcli.evaluation.differences import Difference
from depthcli.evaluation.report import (
    Comparison,
    ReportRow,
    csv_cell,
    csv_text,
    row_json,
    scores_json,
)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class RunsReport(Comparison):
    """Table I of trained runs; the split ``val`` is what the runs themselves held out."""

    rows: tuple[RunsRow, ...]  #: the lines
    differences: tuple[Difference, ...] = ()  #: of one row from every other, if they were asked for

    @property
    def title(self) -> str:
        """Data set, split, number of images and protocol in one line."""
        held_out = self.split == SplitName.VAL
        return self.titled("scenes that the runs held out" if held_out else self.split)

    def to_json(self) -> str:
        """The report as JSON; values that do not exist are null."""
        differences = [_difference(difference) for difference in self.differences]
        more = {"differences": differences} if differences else {}
        return self.document([_run_json(row) for row in self.rows], **more)

    def to_csv(self) -> str:
        """One line per row: what it is, what it cost, then mean and deviation of every metric."""
        origin = ["name", "source", "align", "split", "images", "protocol"]
        lines = [[*origin, *_FACTS, *METRICS, *(f"{metric}_sd" for metric in METRICS)]]
        for line in self.rows:
            row, spread = line.row, line.spread
            known = [row.name, row.source, row.alignment or "", self.split]
            known += [str(row.image_count), self.protocol.name, *_training_columns(line.training)]
            deviations = map(csv_cell, spread.values) if spread else [""] * len(METRICS)
            lines.append([*known, *map(csv_cell, row.scores.values), *deviations])
        return csv_text(lines)


def _run_json(line: RunsRow) -> dict[str, Any]:
    entry = row_json(line.row)
    training = line.training
    if training is not None:
        spread = line.spread
        entry["standard_deviation"] = None if spread is None else scores_json(spread)
        entry["training"] = asdict(training) | {
            "latency_ms": round(training.latency_ms, 3),
            "minutes": [round(minutes, 4) for minutes in training.minutes],
        }
        entry["runs"] = [row_json(row) for row in line.runs]
    return entry


def _difference(difference: Difference) -> dict[str, Any]:
    intervals = zip(METRICS, difference.intervals, strict=True)
    return {
        "row": difference.name,
        "minus": difference.other,
        "align": difference.alignment,
        "intervals": {metric: scores_json(asdict(interval)) for metric, interval in intervals},
    }


def _training_columns(training: Training | None) -> list[str]:
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
