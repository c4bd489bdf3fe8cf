"""The table of training runs (Table I of the paper), as JSON and CSV."""

from dataclasses import asdict, dataclass
from typing import Any

from depthcli.datasets.splits import SplitName
from depthcli.evaluation.choices import Source
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
    """The training of a row; a tuple has one entry per seed."""

    seeds: tuple[int, ...]  #: of the runs
    paired: bool  #: whether they were trained with aligned pairs of picture and depth map
    parameters: int  #: number of the generator's parameters
    #: median latency of the network for one picture, mean over the seeds
    latency_ms: float
    epochs: tuple[int, ...]  #: done
    epochs_planned: int  #: of the whole schedule
    steps: tuple[int, ...]  #: optimization steps done
    minutes: tuple[float, ...]  #: of training


@dataclass(frozen=True, slots=True)
class RunsRow:
    """One line of the table."""

    row: ReportRow  #: name, source, alignment, number of images and mean scores
    #: sample standard deviation over the seeds; None for fewer than two
    std: Scores | None = None
    training: Training | None = None  #: None for rows that are not training runs
    runs: tuple[ReportRow, ...] = ()  #: the rows of the seeds


@dataclass(frozen=True, slots=True, kw_only=True)
class RunsReport(Comparison):
    """The table of training runs; the split ``val`` is the pairs that the runs held out."""

    rows: tuple[RunsRow, ...]  #: the lines

    @property
    def title(self) -> str:
        """Data set, split, number of images and protocol in one line."""
        held_out = self.split == SplitName.VAL
        return self.titled("scenes that the runs held out" if held_out else self.split)

    def to_json(self) -> str:
        """The report as JSON; NaN becomes null."""
        return self.document([_run_json(row) for row in self.rows])

    def to_csv(self) -> str:
        """One line per row: name and training, then mean and standard deviation of every metric."""
        origin = ["name", "source", "align", "split", "images", "protocol"]
        lines = [[*origin, *_FACTS, *METRICS, *(f"{metric}_sd" for metric in METRICS)]]
        for line in self.rows:
            row, std = line.row, line.std
            split = SplitName.PAPER if row.source is Source.PUBLISHED else self.split
            known = [row.name, row.source, row.alignment or "", split]
            known += [str(row.image_count), self.protocol.name, *_training_columns(line.training)]
            deviations = map(csv_cell, std.values) if std else [""] * len(METRICS)
            lines.append([*known, *map(csv_cell, row.scores.values), *deviations])
        return csv_text(lines)


def _run_json(line: RunsRow) -> dict[str, Any]:
    entry = row_json(line.row)
    training = line.training
    if training is not None:
        std = line.std
        entry["standard_deviation"] = None if std is None else scores_json(std)
        entry["training"] = asdict(training) | {
            "latency_ms": round(training.latency_ms, 3),
            "minutes": [round(minutes, 4) for minutes in training.minutes],
        }
        entry["runs"] = [row_json(row) for row in line.runs]
    return entry


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
