"""Evaluating predictors on a data set, image by image."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.base import DepthDataset, HasRawDepth
from depthcli.errors import DatasetError, UsageError
from depthcli.evaluation.choices import Mask, Source
from depthcli.evaluation.predictors.base import Predictor, Sample
from depthcli.evaluation.protocol import HEADLINE, EvalProtocol, Truth, compare_boundaries
from depthcli.evaluation.report import ImageScores, ReportRow
from depthcli.metrics.accumulate import Accumulator, PixelSums
from depthcli.metrics.alignment import SUITABLE
from depthcli.metrics.boundary import BoundaryScores, mean_boundary_scores
from depthcli.metrics.choices import Alignment


@dataclass(frozen=True, slots=True)
class Entry:
    """A predictor and its rows of the table."""

    predictor: Predictor  #: what is evaluated
    alignments: tuple[Alignment, ...] = (Alignment.NONE,)  #: a row for each
    #: number of the evaluated images that it was trained on; None if unknown
    train_overlap: int | None = None


def entry_for(
    predictor: Predictor, wanted: Sequence[Alignment], train_overlap: int | None = None
) -> Entry:
    """An entry with those of the alignments that suit the predictor's kind of depth.

    Raises:
        UsageError: none is left.
    """
    suitable = tuple(a for a in dict.fromkeys(wanted) if a in SUITABLE[predictor.kind])
    if not suitable:
        needed = SUITABLE[predictor.kind][0]
        raise UsageError(
            f"{predictor.name} gives {predictor.kind} depth, which is not metric and has "
            f"to be aligned: add --align {needed}"
        )
    return Entry(predictor, suitable, train_overlap)


@dataclass(frozen=True, slots=True)
class _ImageScores:
    """Sums and scores of one image for one row; small, so that pixels need not be kept."""

    sums: PixelSums
    boundary: BoundaryScores | None
    is_reversed: bool


class _RowAccumulator:
    """Accumulates the scores of a row over the images."""

    def __init__(self, entry: Entry, alignment: Alignment, protocol: EvalProtocol) -> None:
        self._entry, self._alignment = entry, alignment
        self._total = Accumulator(protocol.averaging)
        self._boundaries: list[BoundaryScores] = []
        self._images: list[ImageScores] = []
        self._reversed_count = 0

    def add(self, image_id: str, measured: _ImageScores, *, keep: bool) -> None:
        scores = self._total.add(measured.sums)
        self._reversed_count += measured.is_reversed
        if measured.boundary is not None:
            self._boundaries.append(measured.boundary)
        if keep:
            self._images.append(ImageScores(image_id, scores, measured.boundary))

    def close(self) -> ReportRow:
        predictor, total = self._entry.predictor, self._total
        return ReportRow(
            name=predictor.name,
            source=predictor.source,
            alignment=self._alignment,
            image_count=total.image_count,
            scores=total.compute(),
            empty_count=total.empty_count,
            model_sha256=predictor.model_sha256,
            images=tuple(self._images),
            boundary=mean_boundary_scores(self._boundaries) if self._boundaries else None,
            train_overlap=self._entry.train_overlap,
            reversed_count=self._reversed_count,
            note=self._footnote(),
        )

    def _footnote(self) -> str:
        name, learned = self._entry.predictor.name, self._entry.train_overlap
        notes = []
        if learned:
            notes.append(
                f"{name} was trained on {learned} of these images, or on others of their scenes: "
                "its scores say nothing about new pictures and are not comparable"
            )
        count, images = self._reversed_count, self._total.image_count
        if count and self._entry.predictor.source is not Source.TRIVIAL:
            usual = ": its kind of depth may be wrong" if 2 * count > images else ""
            notes.append(
                f"{name}: the fit ({self._alignment}) reversed the order of depth in {count} of "
                f"{images} images{usual}"
            )
        return "; ".join(notes)


def evaluate(
    dataset: DepthDataset,
    test: Sequence[int],
    entries: Sequence[Entry],
    protocol: EvalProtocol = HEADLINE,
    *,
    per_image: bool = False,
    progress: Progress = NO_PROGRESS,
    workers: int = 0,
) -> tuple[ReportRow, ...]:
    """Score every entry on the same images; each depth is read once, each picture at most once.

    A worker processes a whole image; sums are added in the order of the images, so that results do
    not depend on the number of workers. With 0 workers, the calling thread does the work.

    Raises:
        DatasetError: a pair cannot be read or does not fit the protocol.
        DepthcliError: a predictor failed.
    """
    rows = [
        _RowAccumulator(entry, alignment, protocol)
        for entry in entries
        for alignment in entry.alignments
    ]

    advance = progress.begin("comparing images", len(test))

    def measured(position: int) -> list[_ImageScores]:
        return _score_image(dataset, position, entries, protocol)

    with one_thread_each(workers), closing(ordered_map(measured, test, workers=workers)) as images:
        for position, image in zip(test, images, strict=True):
            for row, one in zip(rows, image, strict=True):
                row.add(dataset.ids[position], one, keep=per_image)
            advance(1)
    return tuple(row.close() for row in rows)


def _score_image(
    dataset: DepthDataset, position: int, entries: Sequence[Entry], protocol: EvalProtocol
) -> list[_ImageScores]:
    """The scores of one image for every row; thread-safe."""
    sample, truth = Sample(dataset, position), _truth(dataset, position, protocol)
    found = []
    for entry in entries:
        depth = entry.predictor.predict(sample)
        for alignment in entry.alignments:
            pixels = protocol.compare(depth, truth, alignment)
            boundary = compare_boundaries(pixels, truth) if protocol.boundary else None
            found.append(_ImageScores(PixelSums.of(pixels), boundary, pixels.is_reversed))
    return found


def _truth(dataset: DepthDataset, position: int, protocol: EvalProtocol) -> Truth:
    depth_m = dataset.depth_m(position)
    raw_depth_m = None
    if protocol.mask is Mask.RAW and isinstance(dataset, HasRawDepth):
        raw_depth_m = dataset.raw_depth_m(position)
    try:
        return protocol.truth(depth_m, raw_depth_m)
    except DatasetError as error:
        raise DatasetError(f"{dataset.ids[position]}: {error}") from error
