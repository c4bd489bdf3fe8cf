"""The table of an evaluation: its rows, breakdowns by parts, JSON and CSV, and the paper's rows."""

import csv
import io
import json
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

from depthcli.io.stored.metadata import SOFTWARE
from depthcli.lab.datasets.base import ALL_PAIRS, HELD_OUT
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.metrics import depth as metrics
from depthcli.lab.metrics.boundary import BoundaryScores
from depthcli.lab.options import Alignment, Part, SplitName

_EDGES_M = (1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 80.0)
_WORST_COUNT = 10
_WORST_BY = "abs_rel"
_NUMBER = re.compile(r"[_/-]?\d+[a-z]?$")  # kitchen_0004, living_room_0012b
_TITLES = {
    Part.DISTANCE: "error by distance: true depth in metres, over the pixels of all images",
    Part.SCENE: "error by scene kind: names of scenes without their number, mean of images",
    Part.IMAGE: f"error by image: the {_WORST_COUNT} of each row with the largest {_WORST_BY}",
}
PUBLISHED_COUNT = 449
_PAPER = tomllib.loads(Path(__file__).with_name("published.toml").read_text("utf-8"))


class Source(StrEnum):
    """The origin of a row's scores."""

    MODEL = "model"  #: a model that was run here
    FILES = "files"  #: depth files that another tool wrote
    TRIVIAL = "trivial"  #: a baseline that ignores the image
    PUBLISHED = "published"  #: printed in the paper; not measured here


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean and its 95 % confidence interval."""

    mean: float
    low: float  #: NaN if the interval is not known
    high: float  #: NaN if the interval is not known

    @property
    def is_significant(self) -> bool:
        """Whether zero is outside the interval."""
        return self.low > 0 or self.high < 0


@dataclass(frozen=True, slots=True)
class Difference:
    """One row's scores minus another's, on the same images."""

    name: str  #: the row that is subtracted from
    other: str  #: the row that is subtracted
    alignment: Alignment | None  #: of both
    #: of every metric, in the order of the table; below 0, ``name`` is better where lower is better
    intervals: tuple[Interval, ...]
    scene_count: int  #: scenes of the images, which are resampled


@dataclass(frozen=True, slots=True)
class PartScores:
    """Scores of one row over a part of the pixels or images."""

    part: str  #: name of the part
    row: str  #: name of the row, and its alignment
    count: int  #: pixels, or images
    scores: metrics.Scores


@dataclass(frozen=True, slots=True)
class Breakdown:
    """Scores of parts of the pixels or images."""

    by: Part
    title: str  #: what the parts are, and how their scores are averaged
    scored: tuple[PartScores, ...]


@dataclass(frozen=True, slots=True)
class ImageScores:
    """Scores of one image; all NaN if it has no valid pixel."""

    id: str
    scores: metrics.Scores


def mean_of_images(images: Iterable[ImageScores]) -> metrics.Scores:
    """Mean over the images with a valid pixel; NaN if none has one."""
    scores = (image.scores for image in images)
    return metrics.mean_of([each for each in scores if any(map(math.isfinite, each.values()))])


@dataclass(frozen=True, slots=True)
class Training:
    """The training of a row; a tuple has one entry per seed."""

    seeds: tuple[int, ...]  #: of the runs
    paired: bool  #: whether they were trained with aligned pairs of image and depth map
    parameters: int  #: number of the generator's parameters
    latency_ms: float  #: median latency of the network for one image, mean over the seeds
    epochs: tuple[int, ...]  #: done
    epochs_planned: int  #: of the whole schedule
    steps: tuple[int, ...]  #: optimization steps done
    minutes: tuple[float, ...]  #: of training


@dataclass(frozen=True, slots=True)
class ReportRow:
    """One line of the table; that of a training run has means over its seeds."""

    name: str  #: what was evaluated
    source: Source  #: origin of its scores
    alignment: Alignment | None  #: alignment per image; None if a published row does not state it
    image_count: int  #: number of images
    scores: metrics.Scores  #: averages over the images, with boundary scores if requested
    empty_count: int = 0  #: images without a valid pixel, which are excluded
    note: str = ""  #: a footnote
    model_sha256: str | None = None  #: checksum of the model, if it is one
    images: tuple[ImageScores, ...] = ()  #: scores per image, if requested
    by_distance: tuple[
        tuple[metrics.PixelSums, ...], ...
    ] = ()  #: the same, of each range of true depth
    train_overlap: int | None = None  #: images that the model was trained on; None if unknown
    reversed_count: int = 0  #: images whose order of depth the alignment reversed
    stated: str = "-"  #: kind and unit of the predictions and who states them
    pixel_count: int = 0  #: pixels that are compared; 0 if it is not known
    missing_count: int = 0  #: pixels of them without a prediction
    outside: tuple[int, int] = (0, 0)  #: pixels with true depth outside the range, and all with it
    training: Training | None = None  #: None for a row that is no training run
    seeds: "tuple[ReportRow, ...]" = ()  #: of a training run, the row of each seed
    std: metrics.Scores | None = None  #: sample standard deviation over seeds, if there are some


@dataclass(frozen=True, slots=True, kw_only=True)
class EvalReport:
    """A table of scores with its data set, split and protocol."""

    dataset: str  #: name of the data set
    split: str  #: name of the split
    image_count: int  #: number of test images that were evaluated
    split_count: int  #: number of test images of the complete split
    train_count: int  #: number of training pairs of the trivial rows; 0 without them
    protocol: EvalProtocol  #: how prediction and ground truth were compared
    rows: tuple[ReportRow, ...]  #: the lines
    notes: tuple[str, ...] = ()  #: footnotes of the table
    differences: tuple[Difference, ...] = ()  #: between one row and every other, if requested
    breakdowns: tuple[Breakdown, ...] = ()  #: scores of parts, if requested
    scenes: Mapping[str, str] = field(default_factory=dict)  #: of images by id, if rows score them

    @property
    def has_training(self) -> bool:
        """Whether rows are training runs, whose table has other columns."""
        return any(row.training for row in self.rows)

    @property
    def title(self) -> str:
        """Data set, split, number of images and protocol in one line."""
        if self.has_training:
            held_out = self.split in {SplitName.VAL, HELD_OUT}
            split = "scenes that the runs held out" if held_out else self.split
        else:
            split = "all pairs" if self.split == ALL_PAIRS else f"{self.split} split"
        count = str(self.image_count)
        if self.image_count != self.split_count:
            count = f"{count} of {self.split_count}"
        count += " image" if self.split_count == 1 else " images"
        return f"{self.dataset} · {split}, {count} · protocol: {self.protocol.name}"

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the scores."""
        return (*metrics.METRICS, *(BoundaryScores._fields if self.protocol.boundary else ()))

    def to_json(self) -> str:
        """The report as JSON; NaN becomes null."""
        names = {"name": self.protocol.name, "description": self.protocol.description}
        protocol = names | asdict(self.protocol)
        del protocol["boundary"]
        document: dict[str, Any] = {
            "schema": 1,
            "software": SOFTWARE,
            "dataset": self.dataset,
            "split": {
                "name": self.split,
                "images": self.image_count,
                "images_of_complete_split": self.split_count,
                "training_pairs_of_trivial_rows": self.train_count,
            },
            "protocol": protocol,
            "metrics": {
                metric.name: {"higher_is_better": metric.higher_is_better, "unit": metric.unit}
                for metric in metrics.METRICS.values()
            },
            "rows": [_row_json(row) for row in self.rows],
            "notes": self.notes,
        }
        if self.differences:
            document["differences"] = list(map(_difference_json, self.differences))
        if self.breakdowns:
            document["breakdowns"] = {
                breakdown.by: list(map(asdict, breakdown.scored)) for breakdown in self.breakdowns
            }
        if self.scenes and any(row.images for row in self.rows):
            document["scenes"] = dict(self.scenes)
        return json.dumps(metrics.finite_or_none(document), indent=2)

    def to_csv(self) -> str:
        """One line per row, each with split, number of images and protocol."""
        text = io.StringIO()
        lines = [dict(self._cells(row)) for row in self.rows]
        names = max(map(list, lines), key=len, default=[])  # training runs have more columns
        writer = csv.DictWriter(text, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)
        return text.getvalue()

    def _cells(self, row: ReportRow) -> Iterator[tuple[str, object]]:
        split = SplitName.PAPER if row.source is Source.PUBLISHED else self.split
        yield from (("name", row.name), ("source", row.source), ("align", row.alignment))
        yield from (("dataset", self.dataset), ("split", split), ("images", row.image_count))
        yield from (("depth", row.stated), ("pixels", row.pixel_count or ""))
        yield from (("trained_on", row.train_overlap), ("protocol", self.protocol.name))
        if row.training:
            yield from _training_cells(row.training).items()
        for name in self.columns:
            yield name, _csv_number(row.scores.get(name, math.nan))
        if row.training:
            for name in metrics.METRICS:
                yield f"{name}_sd", _csv_number(row.std[name]) if row.std else ""


def _csv_number(value: float) -> str:
    """A score with all its digits; empty for NaN."""
    return "" if math.isnan(value) else repr(value)


def _training_cells(training: Training) -> dict[str, str]:
    """The columns of a training run in CSV; several seeds are separated by spaces."""
    return {
        "paired": "yes" if training.paired else "no",
        "seeds": " ".join(map(str, training.seeds)),
        "epochs": " ".join(map(str, training.epochs)),
        "epochs_planned": str(training.epochs_planned),
        "steps": " ".join(map(str, training.steps)),
        "minutes": " ".join(f"{minutes:.2f}" for minutes in training.minutes),
        "parameters": str(training.parameters),
        "ms": f"{training.latency_ms:.3f}",
    }


def _row_json(row: ReportRow) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "name": row.name,
        "source": row.source,
        "align": row.alignment,
        "images": row.image_count,
        "images_without_valid_pixel": row.empty_count,
        "depth": row.stated,
        "pixels": row.pixel_count or None,
        "scores": metrics.in_full(row.scores),
    }
    optional = {
        "images_trained_on": row.train_overlap,
        "images_with_reversed_order": row.reversed_count or None,
        "pixels_without_prediction": row.missing_count or None,
        "note": row.note or None,
        "model_sha256": row.model_sha256,
    }
    entry |= {name: value for name, value in optional.items() if value is not None}
    if row.images:
        entry["per_image"] = [
            {"id": image.id, **metrics.in_full(image.scores)} for image in row.images
        ]
    if row.training is not None:
        entry["standard_deviation"] = row.std
        entry["training"] = asdict(row.training) | {
            "latency_ms": round(row.training.latency_ms, 3),
            "minutes": [round(minutes, 4) for minutes in row.training.minutes],
        }
        entry["runs"] = [_row_json(seed) for seed in row.seeds]
    return entry


def _difference_json(difference: Difference) -> dict[str, Any]:
    return {
        "row": difference.name,
        "minus": difference.other,
        "align": difference.alignment,
        "intervals": dict(zip(metrics.METRICS, map(asdict, difference.intervals), strict=True)),
    }


def distance_ranges(protocol: EvalProtocol) -> list[tuple[float, float]]:
    """Nearest and farthest true depth of each range, metres; they fill that of the protocol."""
    inside = (edge for edge in _EDGES_M if protocol.min_m < edge < protocol.max_m)
    edges = [protocol.min_m, *inside, protocol.max_m]
    return list(pairwise(edges))


def sums_by_distance(
    pixels: metrics.DepthPixels, ranges: Iterable[tuple[float, float]]
) -> tuple[metrics.PixelSums, ...]:
    """Sums of the pixels of one image whose true depth is in each range."""
    sums = []
    for near_m, far_m in ranges:
        inside = (pixels.truth >= near_m) & (pixels.truth < far_m)
        clamp = pixels.min_m, pixels.max_m
        part = metrics.DepthPixels(pixels.truth[inside], pixels.prediction[inside], *clamp)
        sums.append(metrics.PixelSums.of(part))
    return tuple(sums)


def breakdowns(
    parts: Iterable[Part],
    rows: Sequence[ReportRow],
    scenes: Mapping[str, str],
    protocol: EvalProtocol,
) -> tuple[Breakdown, ...]:
    """The breakdowns of rows that have the scores of each image, and sums by distance."""
    scored = {
        Part.DISTANCE: lambda: _by_distance(rows, distance_ranges(protocol)),
        Part.SCENE: lambda: _by_scene(rows, scenes),
        Part.IMAGE: lambda: _worst(rows),
    }
    return tuple(
        Breakdown(part, _TITLES[part], tuple(scored[part]())) for part in dict.fromkeys(parts)
    )


def _by_distance(
    rows: Sequence[ReportRow], ranges: Sequence[tuple[float, float]]
) -> Iterator[PartScores]:
    for i, (near_m, far_m) in enumerate(ranges):
        for row in rows:
            total = reduce(metrics.PixelSums.__add__, (sums[i] for sums in row.by_distance))
            name = f"{near_m:g}-{far_m:g} m"
            yield PartScores(name, _label(row), total.pixel_count, total.scores())


def _by_scene(rows: Sequence[ReportRow], scenes: Mapping[str, str]) -> Iterator[PartScores]:
    kinds = {
        name: "unknown" if scene.startswith("/") else _NUMBER.sub("", scene) or scene
        for name, scene in scenes.items()
    }
    for kind in sorted(set(kinds.values())):
        for row in rows:
            images = [image for image in row.images if kinds[image.id] == kind]
            yield PartScores(kind, _label(row), len(images), mean_of_images(images))


def _worst(rows: Sequence[ReportRow]) -> Iterator[PartScores]:
    for row in rows:
        scored = [image for image in row.images if math.isfinite(image.scores[_WORST_BY])]
        scored.sort(key=lambda image: image.scores[_WORST_BY], reverse=True)
        for image in scored[:_WORST_COUNT]:
            yield PartScores(image.id, _label(row), 1, mean_of_images([image]))


def _label(row: ReportRow) -> str:
    return row.name if row.alignment is Alignment.NONE else f"{row.name}, {row.alignment}"


PUBLISHED = tuple(
    ReportRow(
        name=f"{name} (paper)",
        source=Source.PUBLISHED,
        alignment=None,
        image_count=PUBLISHED_COUNT,
        scores=metrics.in_full(dict(zip(_PAPER["metrics"], scores, strict=True))),
        note=_PAPER["notes"].get(name, ""),
    )
    for name, scores in _PAPER["rows"].items()
)
"""Rows of the paper's Table I, for its 449 test images."""
