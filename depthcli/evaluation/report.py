"""The result of an evaluation, and the same as JSON and CSV."""

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from depthcli.datasets.splits import ALL_PAIRS
from depthcli.evaluation.choices import Source
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.io.writers.facts import SOFTWARE
from depthcli.metrics.accumulate import Scores
from depthcli.metrics.boundary import BOUNDARY_NAMES, NO_BOUNDARY, BoundaryScores
from depthcli.metrics.choices import Alignment
from depthcli.metrics.depth import METRICS


@dataclass(frozen=True, slots=True)
class ImageScores:
    """Scores of one image; all NaN if it has no valid pixel."""

    id: str
    scores: Scores
    boundary: BoundaryScores | None = None


@dataclass(frozen=True, slots=True)
class ReportRow:
    """One line of the table."""

    name: str  #: what was evaluated
    source: Source  #: where its numbers come from
    alignment: Alignment | None  #: what was fitted per image; None if a published row does not say
    image_count: int  #: images that the numbers are the average of
    scores: Scores  #: the numbers
    empty_count: int = 0  #: images left out because no pixel of theirs is valid
    note: str = ""  #: a footnote
    model_sha256: str | None = None  #: checksum of the model, if it is one
    images: tuple[ImageScores, ...] = ()  #: scores per image, if they were asked for
    boundary: BoundaryScores | None = None  #: scores of the edges, if they were asked for
    #: images among these that it was trained on; None if nothing tells
    learned_count: int | None = None

    def items(self, *, boundary: bool) -> tuple[tuple[str, float], ...]:
        """(name, value) of every score, in the order of the table's columns."""
        return (*self.scores.items(), *((self.boundary or NO_BOUNDARY).items() if boundary else ()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What the numbers of a table belong to."""

    dataset: str  #: name of the data set
    split: str  #: which division of it
    image_count: int  #: test images that were compared
    split_count: int  #: test images of the complete split
    train_count: int  #: training pairs behind the trivial rows; 0 without them
    protocol: EvalProtocol  #: how prediction and truth were compared
    notes: tuple[str, ...] = ()  #: what a reader has to know besides

    def titled(self, split: str) -> str:
        """Data set, split in words, number of images and protocol in one line."""
        count = f"{self.image_count} images"
        if self.image_count != self.split_count:
            count = f"{self.image_count} of {self.split_count} images"
        return f"{self.dataset} · {split}, {count} · {self.protocol.name} protocol"

    def document(self, rows: list[dict[str, Any]], **more: object) -> str:
        """The table as JSON."""
        split = {
            "name": self.split,
            "images": self.image_count,
            "images_of_complete_split": self.split_count,
            "training_pairs_of_trivial_rows": self.train_count,
        }
        names = {"name": self.protocol.name, "description": self.protocol.description}
        protocol = names | asdict(self.protocol)
        del protocol["boundary"]
        origin = {"schema": 1, "software": SOFTWARE, "dataset": self.dataset}
        document = origin | {"split": split, "protocol": protocol}
        return json.dumps(document | {"rows": rows, "notes": self.notes} | more, indent=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalReport(Comparison):
    """A table with the protocol and the split that its numbers belong to."""

    rows: tuple[ReportRow, ...]  #: the lines

    @property
    def title(self) -> str:
        """Data set, split, number of images and protocol in one line."""
        return self.titled("all pairs" if self.split == ALL_PAIRS else f"{self.split} split")

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the scores."""
        return (*METRICS, *(BOUNDARY_NAMES if self.protocol.boundary else ()))

    def to_json(self) -> str:
        """The report as JSON; values that do not exist are null."""
        return self.document([row_json(row) for row in self.rows])

    def to_csv(self) -> str:
        """One line per row; split, protocol and number of images in each."""
        origin = ["dataset", "split", "images", "trained_on", "protocol"]
        lines = [["name", "source", "align", *origin, *self.columns]]
        for row in self.rows:
            values = row.items(boundary=self.protocol.boundary)
            learned = "" if row.learned_count is None else str(row.learned_count)
            facts = [self.dataset, self.split, str(row.image_count), learned, self.protocol.name]
            scores = [csv_cell(value) for _, value in values]
            lines.append([row.name, row.source, row.alignment or "", *facts, *scores])
        return csv_text(lines)


def csv_text(lines: Iterable[Sequence[object]]) -> str:
    """Rows of cells as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    return text.getvalue()


def csv_cell(value: float) -> str:
    """A score with all its digits; empty if it does not exist."""
    return "" if math.isnan(value) else repr(value)


def row_json(row: ReportRow) -> dict[str, Any]:
    """A row with its scores, and those of each image if they were kept."""
    entry: dict[str, Any] = {
        "name": row.name,
        "source": row.source,
        "align": row.alignment,
        "images": row.image_count,
        "images_without_valid_pixel": row.empty_count,
        "scores": _all_scores_json(row),
    }
    if row.learned_count is not None:
        entry["images_trained_on"] = row.learned_count
    if row.note:
        entry["note"] = row.note
    if row.model_sha256:
        entry["model_sha256"] = row.model_sha256
    if row.images:
        entry["per_image"] = [{"id": i.id, **_all_scores_json(i)} for i in row.images]
    return entry


def _all_scores_json(scored: ReportRow | ImageScores) -> dict[str, float | None]:
    boundary = scores_json(scored.boundary) if scored.boundary else {}
    return scores_json(scored.scores) | boundary


def scores_json(scores: Scores | BoundaryScores | Mapping[str, float]) -> dict[str, float | None]:
    """Scores by name; a value that does not exist is null."""
    return {name: None if math.isnan(value) else value for name, value in scores.items()}
