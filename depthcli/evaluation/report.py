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
from depthcli.evaluation.differences import Difference
from depthcli.evaluation.protocol import EvalProtocol
from depthcli.io.formats.metadata import SOFTWARE
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
    source: Source  #: origin of its scores
    alignment: Alignment | None  #: alignment per image; None if a published row does not state it
    image_count: int  #: number of images
    scores: Scores  #: averages over the images
    empty_count: int = 0  #: images without a valid pixel, which are excluded
    note: str = ""  #: a footnote
    model_sha256: str | None = None  #: checksum of the model, if it is one
    images: tuple[ImageScores, ...] = ()  #: scores per image, if requested
    boundary: BoundaryScores | None = None  #: boundary scores, if requested
    #: number of these images that the model was trained on; None if unknown
    train_overlap: int | None = None
    reversed_count: int = 0  #: images whose order of depth the alignment reversed

    def items(self, *, boundary: bool) -> tuple[tuple[str, float], ...]:
        """(name, value) of every score, in the order of the table's columns."""
        return (*self.scores.items(), *((self.boundary or NO_BOUNDARY).items() if boundary else ()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Data set, split and protocol of a table."""

    dataset: str  #: name of the data set
    split: str  #: name of the split
    image_count: int  #: number of test images that were evaluated
    split_count: int  #: number of test images of the complete split
    train_count: int  #: number of training pairs of the trivial rows; 0 without them
    protocol: EvalProtocol  #: how prediction and ground truth were compared
    notes: tuple[str, ...] = ()  #: footnotes of the table
    differences: tuple[Difference, ...] = ()  #: between one row and every other, if requested

    def titled(self, split: str) -> str:
        """Data set, split in words, number of images and protocol in one line."""
        count = str(self.image_count)
        if self.image_count != self.split_count:
            count = f"{count} of {self.split_count}"
        count += " image" if self.split_count == 1 else " images"
        return f"{self.dataset} · {split}, {count} · protocol: {self.protocol.name}"

    def document(self, rows: list[dict[str, Any]]) -> str:
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
        document: dict[str, Any] = origin | {"split": split, "protocol": protocol}
        document |= {"rows": rows, "notes": self.notes}
        if self.differences:
            document["differences"] = [_difference_json(found) for found in self.differences]
        return json.dumps(document, indent=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalReport(Comparison):
    """A table of scores with its data set, split and protocol."""

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
        """The report as JSON; NaN becomes null."""
        return self.document([row_json(row) for row in self.rows])

    def to_csv(self) -> str:
        """One line per row, each with split, number of images and protocol."""
        origin = ["dataset", "split", "images", "trained_on", "protocol"]
        lines = [["name", "source", "align", *origin, *self.columns]]
        for row in self.rows:
            values = row.items(boundary=self.protocol.boundary)
            learned = "" if row.train_overlap is None else str(row.train_overlap)
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
    """A score with all its digits; empty for NaN."""
    return "" if math.isnan(value) else repr(value)


def row_json(row: ReportRow) -> dict[str, Any]:
    """A row with its scores, and those of each image if requested."""
    entry: dict[str, Any] = {
        "name": row.name,
        "source": row.source,
        "align": row.alignment,
        "images": row.image_count,
        "images_without_valid_pixel": row.empty_count,
        "scores": _all_scores_json(row),
    }
    if row.train_overlap is not None:
        entry["images_trained_on"] = row.train_overlap
    if row.reversed_count:
        entry["images_with_reversed_order"] = row.reversed_count
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


def _difference_json(difference: Difference) -> dict[str, Any]:
    intervals = zip(METRICS, difference.intervals, strict=True)
    return {
        "row": difference.name,
        "minus": difference.other,
        "align": difference.alignment,
        "intervals": {metric: scores_json(asdict(interval)) for metric, interval in intervals},
    }


def scores_json(scores: Scores | BoundaryScores | Mapping[str, float]) -> dict[str, float | None]:
    """Scores by name; those that are not finite become None."""
    return {name: value if math.isfinite(value) else None for name, value in scores.items()}
