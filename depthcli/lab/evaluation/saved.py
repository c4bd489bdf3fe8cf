"""Reports that were kept as JSON, and their comparison, paired where the images are the same."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.errors import UsageError
from depthcli.io.storage.paths import read_bytes
from depthcli.lab.evaluation import report as table
from depthcli.lab.evaluation.evaluate import differences_from
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.metrics.depth import METRICS, Metric, Scores
from depthcli.lab.options import Alignment, Averaging

_WORDS = ("name", "description")  # of a protocol, made of its other fields


def read_report(path: Path) -> table.EvalReport:
    """The report of ``eval --json``, with scores of each image if it has them."""
    try:
        document: Any = parsed_json(read_bytes(path))
        protocol, split = document["protocol"], document["split"]
        choices = {name: value for name, value in protocol.items() if name not in _WORDS}
        for name, facts in document.get("metrics", {}).items():
            metric = Metric(name, lambda _: (math.nan,), float, **facts, is_whole=True)
            METRICS.setdefault(name, metric)
        return table.EvalReport(
            dataset=document["dataset"],
            split=split["name"],
            image_count=split["images"],
            split_count=split["images_of_complete_split"],
            train_count=0,
            protocol=validated(EvalProtocol, choices),
            rows=tuple(_row(row) for row in document["rows"]),
            notes=tuple(document["notes"]),
            scenes=document.get("scenes", {}),
        )
    except (AttributeError, FieldError, KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path} is not a report of 'depthcli eval --json'") from error


def _row(row: Mapping[str, Any]) -> table.ReportRow:
    return table.ReportRow(
        name=row["name"],
        source=table.Source(row["source"]),
        alignment=None if row["align"] is None else Alignment(row["align"]),
        image_count=row["images"],
        scores=_scores(row["scores"]),
        stated=row["depth"],
        pixel_count=row["pixels"] or 0,
        note=row.get("note", ""),
        model_sha256=row.get("model_sha256"),
        images=tuple(
            table.ImageScores(image["id"], _scores(image)) for image in row.get("per_image", ())
        ),
        train_overlap=row.get("images_trained_on"),
    )


def _scores(values: Mapping[str, Any]) -> Scores:
    """Those of metrics alone, so without the id of an image and boundary scores."""
    scores = ((name, values.get(name)) for name in METRICS)
    return {name: math.nan if value is None else value for name, value in scores}


def compare_reports(first: Path, second: Path) -> table.EvalReport:
    """The rows of two reports, and differences of the first's from the second's.

    If both have scores of each image, all are of the images that both have. Notes of one report
    alone, and those of its rows, begin with its name: their counts are of its images.
    """
    reports = [read_report(first), read_report(second)]
    base = reports[0]
    for what in ("dataset", "protocol"):
        if getattr(base, what) != getattr(reports[1], what):
            raise UsageError(f"{first} and {second} have another {what}", "compare like with like")
    names = [path.stem for path in (first, second)]
    labels = names if names[0] != names[1] else [str(first), str(second)]
    halves = [
        [
            replace(row, name=f"{row.name} ({label})", note=row.note and f"{label}: {row.note}")
            for row in report.rows
            if row.source in {table.Source.MODEL, table.Source.FILES}
        ]
        for report, label in zip(reports, labels, strict=True)
    ]
    notes = tuple(dict.fromkeys(_notes(reports, labels)))
    sets = [{image.id for image in row.images} for row in (*halves[0], *halves[1])]
    shared = set.intersection(*sets) if sets else set()
    if not shared or base.protocol.averaging is Averaging.POOLED:
        note = "no intervals: both need means over the same images (--json --per-image)"
        return replace(base, rows=(*halves[0], *halves[1]), notes=(*notes, note))
    minuends, others = ([_part_of(row, shared) for row in half] for half in halves)
    scenes = {name: base.scenes.get(name, f"/{name}") for name in shared}
    differences = list[table.Difference]()
    for name, rows in _by_name(minuends).items():
        differences += differences_from(name, {name: rows, **_by_name(others)}, scenes)
    return replace(
        base,
        image_count=len(shared),
        rows=(*minuends, *others),
        notes=notes,
        differences=tuple(differences),
        scenes=scenes,
    )


def check_consistency(report: table.EvalReport, tolerance: float) -> tuple[table.EvalReport, bool]:
    """The report of a comparison with a note on each model, and whether all are consistent.

    A row is consistent with that of its name in the other report, or with each if none has its
    name, if the intervals of all differences lie within a share of the other's scores.
    """
    scores = {(row.name, row.alignment): row.scores for row in report.rows}
    pairs = [(each, each.name.rpartition(" (")[0]) for each in report.differences]
    of_one = [each for each, name in pairs if name == each.other.rpartition(" (")[0]]
    notes, is_consistent = [], True
    for difference in of_one or report.differences:
        reference = scores[difference.other, difference.alignment]
        apart = [
            f"{name} by {interval.mean:+.4f} ({interval.low:+.4f} to {interval.high:+.4f})"
            for name, interval in zip(METRICS, difference.intervals, strict=True)
            if _is_apart(interval, tolerance * reference[name])
        ]
        is_consistent &= not apart
        verdict = "differs from" if apart else "is consistent with"
        how = ", ".join(apart) or f"within {tolerance:.3g} of its scores"
        notes.append(f"{difference.name} {verdict} {difference.other}: {how}")
    if not notes:
        advice = "evaluate both with {json} and {per_image}"
        raise UsageError("there are no scores of the same images", advice)
    return replace(report, notes=(*report.notes, *notes)), is_consistent


def _is_apart(interval: table.Interval, most: float) -> bool:
    """Whether an interval, or the mean of a single scene, goes beyond ± ``most``."""
    ends = (interval.mean, interval.low, interval.high)
    return any(abs(end) > most for end in ends if math.isfinite(end))


def _notes(reports: Sequence[table.EvalReport], labels: Sequence[str]) -> Iterator[str]:
    for report, label in zip(reports, labels, strict=True):
        for note in report.notes:
            is_shared = all(note in other.notes for other in reports)
            yield note if is_shared else f"{label}: {note}"


def _part_of(row: table.ReportRow, shared: set[str]) -> table.ReportRow:
    images = sorted(
        (image for image in row.images if image.id in shared), key=lambda image: image.id
    )
    if len(images) == len(row.images):
        return replace(row, images=tuple(images))
    part = replace(row, images=tuple(images), image_count=len(images), pixel_count=0)
    overlap = 0 if row.train_overlap == 0 else None  # of some of the images, it is not known
    return replace(part, scores=table.mean_of_images(images), train_overlap=overlap)


def _by_name(rows: Sequence[table.ReportRow]) -> dict[str, list[table.ReportRow]]:
    return {name: [row for row in rows if row.name == name] for name in (r.name for r in rows)}
