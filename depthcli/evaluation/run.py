"""A data set, predictors and a protocol, to a report: one image at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.datasets.base import HasRawDepth
from depthcli.errors import DatasetError, UsageError
from depthcli.evaluation.choices import Mask
from depthcli.evaluation.predictors import Sample
from depthcli.evaluation.protocol import Protocol, compare_boundaries
from depthcli.evaluation.report import ImageScores, Row
from depthcli.metrics.accumulate import Accumulator
from depthcli.metrics.alignment import SUITABLE
from depthcli.metrics.boundary import BoundaryAccumulator
from depthcli.metrics.choices import Alignment

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from depthcli.datasets.base import DepthDataset
    from depthcli.evaluation.predictors import Predictor
    from depthcli.evaluation.protocol import Truth
    from depthcli.metrics.depth import DepthPixels


@dataclass(frozen=True, slots=True)
class Entry:
    """A predictor and the alignments that it gets a row for."""

    predictor: Predictor
    alignments: tuple[Alignment, ...] = (Alignment.NONE,)


def enter(predictor: Predictor, wanted: Sequence[Alignment]) -> Entry:
    """Keep the alignments that mean something for what the predictor gives.

    Raises:
        UsageError: none is left.
    """
    suitable = tuple(a for a in dict.fromkeys(wanted) if a in SUITABLE[predictor.kind])
    if not suitable:
        needed = SUITABLE[predictor.kind][0]
        raise UsageError(
            f"{predictor.name} gives {predictor.kind} depth, which has no metres before it is "
            f"aligned: add --align {needed}"
        )
    return Entry(predictor, suitable)


@dataclass(slots=True)
class _OpenRow:
    """A row while images go by."""

    predictor: Predictor
    alignment: Alignment
    total: Accumulator
    images: list[ImageScores] = field(default_factory=list)
    edges: BoundaryAccumulator | None = None

    @classmethod
    def of(cls, predictor: Predictor, alignment: Alignment, protocol: Protocol) -> _OpenRow:
        edges = BoundaryAccumulator() if protocol.boundary else None
        return cls(predictor, alignment, Accumulator(protocol.averaging), edges=edges)

    def add(self, sample: Sample, pixels: DepthPixels, truth: Truth, *, keep: bool) -> None:
        scores, boundary = self.total.update(pixels), None
        if self.edges is not None:
            boundary = compare_boundaries(pixels, truth)
            self.edges.update(boundary)
        if keep:
            self.images.append(ImageScores(sample.id, scores, boundary))

    def close(self) -> Row:
        return Row(
            name=self.predictor.name,
            source=self.predictor.source,
            alignment=self.alignment,
            image_count=self.total.image_count,
            scores=self.total.compute(),
            empty_count=self.total.empty_count,
            model_sha256=self.predictor.model_sha256,
            images=tuple(self.images),
            boundary=self.edges.compute() if self.edges else None,
        )


def evaluate(
    dataset: DepthDataset,
    test: Sequence[int],
    entries: Sequence[Entry],
    protocol: Protocol | None = None,
    *,
    per_image: bool = False,
    progress: Callable[[], None] = lambda: None,
) -> tuple[Row, ...]:
    """Score every entry on the same images; each depth is read once, each picture at most once.

    Args:
        dataset: where the pairs are.
        test: positions of the images to compare.
        entries: what to score.
        protocol: how to compare; the headline protocol if None.
        per_image: keep the scores of each image in the rows.
        progress: called after each image.

    Raises:
        DatasetError: a pair cannot be read or does not fit the protocol.
        DepthcliError: a predictor failed.
    """
    protocol = protocol or Protocol()
    rows = [
        [_OpenRow.of(entry.predictor, alignment, protocol) for alignment in entry.alignments]
        for entry in entries
    ]
    for position in test:
        sample = Sample(dataset, position)
        truth = _truth(dataset, position, protocol)
        for entry, open_rows in zip(entries, rows, strict=True):
            depth = entry.predictor.predict(sample)
            for row in open_rows:
                pixels = protocol.compare(depth, truth, row.alignment)
                row.add(sample, pixels, truth, keep=per_image)
        progress()
    return tuple(row.close() for open_rows in rows for row in open_rows)


def _truth(dataset: DepthDataset, position: int, protocol: Protocol) -> Truth:
    depth_m = dataset.depth_m(position)
    raw_depth_m = None
    if protocol.mask is Mask.RAW and isinstance(dataset, HasRawDepth):
        raw_depth_m = dataset.raw_depth_m(position)
    try:
        return protocol.truth(depth_m, raw_depth_m)
    except DatasetError as error:
        raise DatasetError(f"{dataset.ids[position]}: {error}") from error
