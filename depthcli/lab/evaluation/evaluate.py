"""Evaluating predictors on a data set, image by image, and comparing their rows.

Differences between rows are paired, with intervals by a bootstrap over scenes: images of one scene
are correlated, so scenes are resampled, not images.
Source: Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, chapter 13 (percentiles).
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from depthcli.core.parallel import NO_PROGRESS, Progress, one_thread_each, ordered_map
from depthcli.core.types import Float64Array
from depthcli.errors import DatasetError, UsageError
from depthcli.lab.datasets.base import DepthDataset
from depthcli.lab.evaluation import predictors as sources, report
from depthcli.lab.evaluation.protocol import HEADLINE, EvalProtocol, compare_boundaries
from depthcli.lab.evaluation.task import EvalTask, group_by_seed, train_mark, train_overlap
from depthcli.lab.metrics.alignment import SUITABLE, align
from depthcli.lab.metrics.boundary import BoundaryScores, mean_boundary_scores
from depthcli.lab.metrics.depth import METRICS, PixelSums, Scores, mean_of, mean_scores, values_of
from depthcli.lab.options import Alignment, Averaging, Mask, Part, SplitName
from depthcli.lab.training.provenance import TrainedRun

_PAPER_ORDER = [row.name.removesuffix(" (paper)").lower() for row in report.PUBLISHED]
_RESAMPLES = 10_000
_BLOCK = 100  # resamplings at a time, which bounds the memory for data sets of many scenes
_PERCENTILES = (2.5, 97.5)


@dataclass(frozen=True, slots=True)
class EvalOptions:
    """Options of a table."""

    protocol: EvalProtocol = HEADLINE  #: how prediction and ground truth are compared
    #: a row for each that suits a predictor; trivial rows also have none and median
    alignments: tuple[Alignment, ...] = (Alignment.NONE,)
    trivial: bool = True  #: include baselines that ignore the image
    published: bool = True  #: include the paper's rows, of models only where they are comparable
    per_image: bool = False  #: keep the scores of each image
    against: str | None = None  #: also compare this row with every other
    parts: tuple[Part, ...] = ()  #: also score parts of the pixels or images
    workers: int = 0  #: images processed in parallel; 0 for the calling thread


HEADLINE_TABLE = EvalOptions()


class Entry(NamedTuple):
    """A predictor and its rows of the table."""

    predictor: sources.Predictor  #: what is evaluated
    alignments: tuple[Alignment, ...]  #: a row for each
    train_overlap: int | None = None  #: number of the images it was trained on; None if unknown
    mark: str = ""  #: footnote about training on these images


def entry_for(
    predictor: sources.Predictor,
    alignments: Sequence[Alignment] = (Alignment.NONE,),
    train_overlap: int | None = None,
    mark: str = "",
) -> Entry:
    """An entry with those of the alignments that suit the predictor's kind of depth."""
    suitable = tuple(a for a in dict.fromkeys(alignments) if a in SUITABLE[predictor.kind])
    if not suitable:
        message = f"{predictor.name} gives {predictor.kind} depth, which has to be aligned"
        raise UsageError(message, f"add {{align}} {SUITABLE[predictor.kind][0]}")
    return Entry(predictor, suitable, train_overlap, mark)


class _Line(NamedTuple):
    """The predictors that one name of the table stands for: one, or the seeds of a training run."""

    name: str
    entries: tuple[Entry, ...]

    @property
    def runs(self) -> list[tuple[sources.ModelPredictor, TrainedRun]]:
        """The seeds of a training run with their models; empty for other predictors."""
        models = (entry.predictor for entry in self.entries)
        return [(m, m.run) for m in models if isinstance(m, sources.ModelPredictor) and m.run]


def evaluate(
    task: EvalTask,
    predictors: Sequence[sources.Predictor],
    options: EvalOptions = HEADLINE_TABLE,
    progress: Progress = NO_PROGRESS,
) -> report.EvalReport:
    """The table: trivial rows, predictors (seeds of a training run are one row), published rows."""
    lines = _lines(task, predictors, options)
    trivial = sources.TRIVIAL_NAMES if options.trivial and task.split.train else ()
    if options.against is not None:
        names = [*trivial, *(line.name for line in lines)]
        check_against(options.against, names, options.protocol)
    if trivial:
        alignments = (Alignment.NONE, Alignment.MEDIAN, *options.alignments)
        means = sources.fit_trivial(
            task.dataset, task.split.train, options.protocol, progress, options.workers
        )
        lines = [*(_Line(mean.name, (entry_for(mean, alignments),)) for mean in means), *lines]
    scored = score(
        task.dataset,
        task.test,
        [entry for line in lines for entry in line.entries],
        options.protocol,
        progress=progress,
        workers=options.workers,
        ranges_m=report.distance_ranges(options.protocol) if Part.DISTANCE in options.parts else (),
    )
    if scored and not any(row.pixel_count for row in scored):
        low_m, high_m = options.protocol.min_m, options.protocol.max_m
        message = f"of {len(task.test)} images has depth between {low_m:g} and {high_m:g} m"
        raise DatasetError(f"no pixel {message}", "check the unit, and the range that counts")
    outside = scored[0].outside if scored else (0, 0)
    rest = iter(scored)
    each = [[next(rest) for entry in line.entries for _ in entry.alignments] for line in lines]
    differences: tuple[report.Difference, ...] = ()
    if options.against is not None:
        by_name = {line.name: rows for line, rows in zip(lines, each, strict=True)}
        differences = differences_from(options.against, by_name, task.scenes)
    broken_down = report.breakdowns(options.parts, scored, task.scenes, options.protocol)
    if not options.per_image:
        each = [[replace(row, images=()) for row in rows] for rows in each]
    rows: list[report.ReportRow] = []
    for line, seeds in zip(lines, each, strict=True):
        kinds = dict.fromkeys(row.alignment for row in seeds) if line.runs else {}
        rows += seeds if not kinds else [_mean_row(line, seeds, alignment) for alignment in kinds]
    if any(line.runs for line in lines):
        # Other rows, then training runs in the order of the paper, then by name.
        places = {row.name: [*_PAPER_ORDER, row.name].index(row.name) for row in rows}
        rows.sort(key=lambda row: (places[row.name], row.name) if row.training else (-1, ""))
        rows += report.PUBLISHED if options.published else ()
    elif options.published and _is_headline(task, options):
        rows = [*report.PUBLISHED, *rows]
    return report.EvalReport(
        dataset=task.title,
        split=task.split.name,
        image_count=len(task.test),
        split_count=task.split.test_count,
        train_count=len(task.split.train) if options.trivial else 0,
        protocol=options.protocol,
        rows=tuple(rows),
        notes=(*task.dataset.notes, *_notes(task, lines, options, *outside)),
        differences=differences,
        breakdowns=broken_down,
        scenes=task.scenes,
    )


def check_against(name: str, rows: Sequence[str], protocol: EvalProtocol = HEADLINE) -> None:
    """Check that a row can be compared with others, image by image."""
    if protocol.averaging is Averaging.POOLED:
        raise UsageError(
            "it compares means over images", "remove {average} pooled", option="against"
        )
    if name not in rows:
        raise UsageError(f"{name} is not a row; choose from {', '.join(rows)}", option="against")
    if set(rows) == {name}:
        raise UsageError(f"there is no other row than {name}", "add one", option="against")


def _lines(
    task: EvalTask, predictors: Sequence[sources.Predictor], options: EvalOptions
) -> list[_Line]:
    """Predictors with their rows; seeds of a training run stand together."""
    runs = [p.run for p in predictors if isinstance(p, sources.ModelPredictor) and p.run]
    group_of = {run.name: name for name, seeds in group_by_seed(runs).items() for run in seeds}
    groups: dict[object, tuple[str, list[Entry]]] = {}
    for predictor in predictors:
        is_run, card = False, None
        if isinstance(predictor, sources.ModelPredictor):
            is_run, card = predictor.run is not None, predictor.pipeline.card
        name = group_of[predictor.name] if is_run else predictor.name
        overlap = None if card is None else train_overlap(card, task)
        mark = "" if card is None or is_run else train_mark(predictor.name, card, task, overlap)
        entry = entry_for(predictor, options.alignments, overlap, mark)
        groups.setdefault(name if is_run else id(predictor), (name, []))[1].append(entry)
    return [_Line(name, tuple(entries)) for name, entries in groups.values()]


def _mean_row(
    line: _Line, rows: Sequence[report.ReportRow], alignment: Alignment | None
) -> report.ReportRow:
    seeds = [row for row in rows if row.alignment is alignment]
    scores = [row.scores for row in seeds]
    std = values_of(scores).std(0, ddof=1).tolist() if len(seeds) > 1 else None
    first = seeds[0]
    return report.ReportRow(  # not all that is of the first seed is of the mean
        name=line.name,
        source=first.source,
        alignment=first.alignment,
        image_count=first.image_count,
        scores=mean_of(scores),
        empty_count=first.empty_count,
        stated=first.stated,
        pixel_count=first.pixel_count,
        note="; ".join(dict.fromkeys(row.note for row in seeds if row.note)),
        training=_training_of(line),
        seeds=tuple(seeds),
        std=None if std is None else dict(zip(METRICS, std, strict=True)),
    )


def _training_of(line: _Line) -> report.Training:
    runs = [run for _, run in line.runs]
    first, states = runs[0].config, [run.state for run in runs]
    return report.Training(
        seeds=tuple(run.config.seed for run in runs),
        paired=first.data.paired,
        parameters=runs[0].parameters,
        latency_ms=float(np.mean([model.latency_ms for model, _ in line.runs])),
        epochs=tuple(state.epoch for state in states),
        epochs_planned=first.optim.epochs,
        steps=tuple(state.step for state in states),
        minutes=tuple(state.seconds / 60 for state in states),
    )


def _is_headline(task: EvalTask, options: EvalOptions) -> bool:
    return task.split.name == SplitName.PAPER and options.protocol == HEADLINE


def _notes(
    task: EvalTask, lines: Sequence[_Line], options: EvalOptions, outside: int, total: int
) -> Iterator[str]:
    """Notes on the table; of ``total`` pixels with true depth, some are ``outside`` the range."""
    split, runs = task.split, [pair for line in lines for pair in line.runs]
    if 2 * outside > total:
        low_m, high_m = options.protocol.min_m, options.protocol.max_m
        yield (
            f"{outside / total:.0%} of the true depth is not between {low_m:g} and {high_m:g} m "
            "and does not count: check its unit and the range"
        )
    if runs:
        yield "± is the sample standard deviation over the seeds"
        providers = sorted({model.pipeline.session.provider for model, _ in runs})
        timed = f"onnxruntime on {', '.join(providers)}, measured in turns in this run"
        yield f"ms: median of the network alone for one image, {timed}"
        short = [run.name for _, run in runs if run.state.epoch < run.config.optim.epochs]
        if short:
            yield f"stopped before their schedule's end: {', '.join(short)}"
        if options.published and split.name != SplitName.PAPER:
            images = f"its own {report.PUBLISHED_COUNT} test images, not of these"
            yield f"the paper's rows are of {images}: their numbers are not comparable"
    elif task.is_nyu and not _is_headline(task, options):
        rows = "the paper's rows belong to the paper split and the headline protocol"
        yield f"{rows} and are omitted here"
    if not runs and split.name == SplitName.VAL and len(split.test) != split.test_count:
        scenes = "the held-out scenes are not those of all of them"
        yield f"not all of pairs 1-1000 are here, so {scenes}"
    if options.trivial and not split.train:
        yield "no training pair of this split is available: baselines are omitted"
    elif options.trivial and len(split.train) != split.train_count:
        counts = f"{len(split.train)} of the split's {split.train_count} training pairs"
        yield f"the mean rows were computed from {counts}"


class _ImageSums(NamedTuple):
    """Sums and scores of one image for one row; small, so that pixels need not be kept."""

    sums: PixelSums
    boundary: BoundaryScores | None
    is_reversed: bool
    missing_count: int  #: pixels without a prediction
    outside: tuple[int, int]  #: pixels whose true depth is outside the range, and with true depth
    by_distance: tuple[PixelSums, ...]  #: of the pixels of each range of true depth

    @property
    def scores(self) -> Scores:
        """Every score of the image."""
        return self.sums.scores() | (self.boundary._asdict() if self.boundary else {})


def _row_of(
    entry: Entry, alignment: Alignment, averaging: Averaging, scored: Mapping[str, _ImageSums]
) -> report.ReportRow:
    predictor, images = entry.predictor, scored.values()
    model = (
        predictor.pipeline.session.model if isinstance(predictor, sources.ModelPredictor) else None
    )
    boundaries = [image.boundary for image in images if image.boundary is not None]
    boundary = mean_boundary_scores(boundaries)._asdict() if boundaries else {}
    image_count = sum(image.sums.pixel_count > 0 for image in images)
    row = report.ReportRow(
        name=predictor.name,
        source=predictor.source,
        alignment=alignment,
        image_count=image_count,
        scores=mean_scores((image.sums for image in images), averaging) | boundary,
        empty_count=len(images) - image_count,
        model_sha256=model.sha256 if model else None,
        images=tuple(report.ImageScores(name, image.scores) for name, image in scored.items()),
        by_distance=tuple(image.by_distance for image in images),
        train_overlap=entry.train_overlap,
        reversed_count=sum(image.is_reversed for image in images),
        stated=predictor.stated,
        pixel_count=sum(image.sums.pixel_count for image in images),
        missing_count=sum(image.missing_count for image in images),
        outside=(sum(i.outside[0] for i in images), sum(i.outside[1] for i in images)),
    )
    return replace(row, note="; ".join(_footnotes(row, entry.mark)))


def _footnotes(row: report.ReportRow, mark: str) -> Iterator[str]:
    name, count, images = row.name, row.reversed_count, row.image_count
    if mark:
        yield mark
    if row.missing_count:
        pixels = f"{row.missing_count} of {row.pixel_count} pixels"
        yield f"{name} has no depth in {pixels}, which count as the nearest depth"
    if count and row.source is not report.Source.TRIVIAL:
        usual = ": its kind of depth may be wrong" if 2 * count > images else ""
        if row.alignment is not Alignment.NONE:
            yield (
                f"{name}: the fit ({row.alignment}) reversed the order of depth in {count} "
                f"of {images} images{usual}"
            )
        elif usual:
            yield f"{name}: near and far are exchanged in {count} of {images} images{usual}"


def score(
    dataset: DepthDataset,
    test: Sequence[int],
    entries: Sequence[Entry],
    protocol: EvalProtocol = HEADLINE,
    *,
    progress: Progress = NO_PROGRESS,
    workers: int = 0,
    ranges_m: Sequence[tuple[float, float]] = (),
) -> tuple[report.ReportRow, ...]:
    """A row for each alignment of each entry, scored on the same images, each read at most once.

    Sums are added in the order of the images, so results do not depend on the number of workers.
    With 0 workers, the calling thread does the work.
    """
    rows = [(entry, alignment) for entry in entries for alignment in entry.alignments]
    scored: list[dict[str, _ImageSums]] = [{} for _ in rows]
    advance = progress.begin("comparing images", len(test))
    score = partial(_score_image, dataset, entries, protocol, ranges_m)
    with one_thread_each(workers), closing(ordered_map(score, test, workers=workers)) as images:
        for position, image in zip(test, images, strict=True):
            for by_id, sums in zip(scored, image, strict=True):
                by_id[dataset.ids[position]] = sums
            advance(1)
    each = zip(rows, scored, strict=True)
    return tuple(_row_of(*row, protocol.averaging, images) for row, images in each)


def _score_image(
    dataset: DepthDataset,
    entries: Sequence[Entry],
    protocol: EvalProtocol,
    ranges_m: Sequence[tuple[float, float]],
    position: int,
) -> list[_ImageSums]:
    """The scores of one image for every row; thread-safe."""
    sample, rows, depth_m = sources.Sample(dataset, position), [], dataset.depth_m(position)
    raw_depth_m = dataset.raw_depth_m(position) if protocol.mask is Mask.RAW else None
    try:
        truth = protocol.truth(depth_m, raw_depth_m)
    except DatasetError as error:
        raise DatasetError(error.message.about(sample.id)) from error
    has_depth = depth_m > 0
    counted = (depth_m > protocol.min_m) & (depth_m < protocol.max_m)
    outside = int(np.count_nonzero(has_depth & ~counted)), int(np.count_nonzero(has_depth))
    for entry in entries:
        depth = entry.predictor.predict(sample)
        for alignment in entry.alignments:
            pixels = protocol.compare(depth, truth, alignment)
            boundary = compare_boundaries(pixels, truth) if protocol.boundary else None
            missing = int(np.count_nonzero(np.isnan(pixels.prediction)))
            turned = pixels.is_reversed
            if entry.predictor.source is report.Source.FILES and alignment is Alignment.NONE:
                predicted, true_m = pixels.prediction, pixels.truth
                exact = predicted.astype(np.float64), true_m.astype(np.float64)
                _, turned = align(*exact, Alignment.DEPTH)
            sums, parts = PixelSums.of(pixels), report.sums_by_distance(pixels, ranges_m)
            rows.append(_ImageSums(sums, boundary, turned, missing, outside, parts))
    return rows


def differences_from(
    name: str, groups: Mapping[str, Sequence[report.ReportRow]], scenes: Mapping[str, str]
) -> tuple[report.Difference, ...]:
    """Paired differences between one row and every other of the same alignment.

    ``groups`` has the rows of each seed by name, with scores per image; ``scenes`` is by image.
    """
    differences = []
    for alignment in dict.fromkeys(row.alignment for row in groups[name]):
        minuend = _per_image(groups[name], alignment)
        order = [scenes[image.id] for image in groups[name][0].images]
        for other, rows in groups.items():
            if other == name or all(row.alignment is not alignment for row in rows):
                continue
            values = minuend - _per_image(rows, alignment)
            intervals = tuple(scene_interval(column, order) for column in values.T)
            is_scored = np.isfinite(values).any(1)  # others were excluded
            scenes_scored = set(np.asarray(order)[is_scored])
            differences.append(
                report.Difference(name, other, alignment, intervals, len(scenes_scored))
            )
    return tuple(differences)


def _per_image(rows: Sequence[report.ReportRow], alignment: Alignment | None) -> Float64Array:
    """(N, metrics): the scores of each image, averaged over the seeds."""
    seeds = [row.images for row in rows if row.alignment is alignment]
    values = [values_of(image.scores for image in images) for images in seeds]
    return np.asarray(np.mean(values, 0))


def scene_interval(values: Float64Array, scenes: Sequence[str]) -> report.Interval:
    """The mean of a value (N,) per image, NaN for none, and its interval: scenes are resampled."""
    valid_mask = np.isfinite(values)
    _, scene = np.unique(np.asarray(scenes)[valid_mask], return_inverse=True)
    sums = np.bincount(scene, values[valid_mask])
    counts = np.bincount(scene)
    if not len(sums):
        return report.Interval(np.nan, np.nan, np.nan)
    mean = float(sums.sum() / counts.sum())
    if len(sums) == 1:  # whose resamplings are all the same, however much other scenes differ
        return report.Interval(mean, np.nan, np.nan)
    share, rng, means = np.full(len(sums), 1 / len(sums)), np.random.default_rng(0), []
    for _ in range(_RESAMPLES // _BLOCK):
        drawn = rng.multinomial(len(sums), share, _BLOCK)
        means.append((drawn @ sums) / (drawn @ counts))
    low, high = np.percentile(np.concatenate(means), _PERCENTILES)
    return report.Interval(mean, float(low), float(high))
