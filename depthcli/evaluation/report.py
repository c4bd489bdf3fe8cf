"""The result of an evaluation, and the same as JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from depthcli.metrics.boundary import BOUNDARY_NAMES, NO_BOUNDARY
from depthcli.metrics.depth import METRICS

if TYPE_CHECKING:
    from depthcli.datasets.splits import SplitName
    from depthcli.evaluation.choices import Source
    from depthcli.evaluation.protocol import EvalProtocol
    from depthcli.metrics.accumulate import Scores
    from depthcli.metrics.boundary import BoundaryScores
    from depthcli.metrics.choices import Alignment


@dataclass(frozen=True, slots=True)
class ImageScores:
    """Scores of one image; all NaN if it has no valid pixel."""

    id: str
    scores: Scores
    boundary: BoundaryScores | None = None


@dataclass(frozen=True, slots=True)
class ReportRow:
    """One line of the table.

    Attributes:
        name: what was evaluated.
        source: where its numbers come from.
        alignment: what was fitted per image; None if a published row does not say.
        image_count: images that the numbers are the average of.
        scores: the numbers.
        empty_count: images left out because no pixel of theirs is valid.
        note: a footnote.
        model_sha256: checksum of the model, if it is one.
        images: scores per image, if they were asked for.
        boundary: scores of the edges, if they were asked for.
        learned_count: images among these that it was trained on; None if nothing tells.
    """

    name: str
    source: Source
    alignment: Alignment | None
    image_count: int
    scores: Scores
    empty_count: int = 0
    note: str = ""
    model_sha256: str | None = None
    images: tuple[ImageScores, ...] = ()
    boundary: BoundaryScores | None = None
    learned_count: int | None = None

    def items(self, *, boundary: bool) -> tuple[tuple[str, float], ...]:
        """(name, value) of every score, in the order of the table's columns."""
        return (*self.scores.items(), *((self.boundary or NO_BOUNDARY).items() if boundary else ()))


@dataclass(frozen=True, slots=True)
class EvalReport:
    """A table with the protocol and the split that its numbers belong to.

    Attributes:
        dataset: name of the data set.
        split: which division of it.
        image_count: test images that were compared.
        split_count: test images of the complete split.
        train_count: training pairs that the trivial rows were computed from; 0 without them.
        protocol: how prediction and truth were compared.
        rows: the lines.
        notes: what a reader has to know besides.
    """

    dataset: str
    split: SplitName
    image_count: int
    split_count: int
    train_count: int
    protocol: EvalProtocol
    rows: tuple[ReportRow, ...]
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Data set, split, number of images and protocol in one line."""
        count = f"{self.image_count} images"
        if self.image_count != self.split_count:
            count = f"{self.image_count} of {self.split_count} images"
        return f"{self.dataset} · {self.split} split, {count} · {self.protocol.name} protocol"

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the scores."""
        return (*METRICS, *(BOUNDARY_NAMES if self.protocol.boundary else ()))

    def to_json(self) -> str:
        """The report as JSON; values that do not exist are null."""
        document = {
            "schema": 1,
            "dataset": self.dataset,
            "split": {
                "name": self.split,
                "images": self.image_count,
                "images_of_complete_split": self.split_count,
                "training_pairs_of_trivial_rows": self.train_count,
            },
            "protocol": protocol_json(self.protocol),
            "rows": [row_json(row) for row in self.rows],
            "notes": self.notes,
        }
        return json.dumps(document, indent=2)

    def to_csv(self) -> str:
        """One line per row; split, protocol and number of images in each."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        origin = ["dataset", "split", "images", "trained_on", "protocol"]
        writer.writerow(["name", "source", "align", *origin, *self.columns])
        for row in self.rows:
            values = row.items(boundary=self.protocol.boundary)
            scores = ["" if math.isnan(value) else repr(value) for _, value in values]
            align = row.alignment or ""
            learned = "" if row.learned_count is None else str(row.learned_count)
            facts = [self.dataset, self.split, str(row.image_count), learned, self.protocol.name]
            writer.writerow([row.name, row.source, align, *facts, *scores])
        return text.getvalue()


def protocol_json(protocol: EvalProtocol) -> dict[str, Any]:
    """A protocol with all its choices."""
    return {
        "name": protocol.name,
        "description": protocol.description,
        "averaging": protocol.averaging,
        "crop": protocol.crop,
        "mask": protocol.mask,
        "compare_px": protocol.compare_px,
        "upsampling": protocol.upsampling,
        "tile_px": protocol.tile_px,
        "full_size_px": protocol.full_size_px,
        "min_m": protocol.min_m,
        "max_m": protocol.max_m,
    }


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


def scores_json(scores: Scores | BoundaryScores) -> dict[str, float | None]:
    """Scores by name; a value that does not exist is null."""
    return {name: None if math.isnan(value) else value for name, value in scores.items()}
