"""Scores of parts of an evaluation: by true distance, by kind of scene, and of the worst images."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import pairwise

import numpy as np

from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.report import Breakdown, PartScores, ReportRow, mean_of
from depthcli.lab.metrics.depth import PixelSums
from depthcli.lab.metrics.pixels import DepthPixels
from depthcli.lab.options import Alignment, Part

_EDGES_M = (1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 80.0)
_WORST_COUNT = 10
_WORST_BY = "abs_rel"
_NUMBER = re.compile(r"[_/-]?\d+[a-z]?$")  # kitchen_0004, living_room_0012b
_TITLES = {
    Part.DISTANCE: "error by distance: true depth in metres, over the pixels of all images",
    Part.SCENE: "error by scene kind: names of scenes without their number, mean of images",
    Part.IMAGE: f"error by image: the {_WORST_COUNT} of each row with the largest {_WORST_BY}",
}


def distance_ranges(protocol: EvalProtocol) -> list[tuple[float, float]]:
    """Nearest and farthest true depth of each range, metres; they fill that of the protocol."""
    inside = (edge for edge in _EDGES_M if protocol.min_m < edge < protocol.max_m)
    edges = [protocol.min_m, *inside, protocol.max_m]
    return list(pairwise(edges))


def sums_by_distance(
    pixels: DepthPixels, ranges: Iterable[tuple[float, float]]
) -> tuple[PixelSums, ...]:
    """Sums of the pixels of one image whose true depth is in each range."""
    sums = []
    for near_m, far_m in ranges:
        inside = (pixels.truth >= near_m) & (pixels.truth < far_m)
        clamp = pixels.min_m, pixels.max_m
        part = DepthPixels(pixels.truth[inside], pixels.prediction[inside], *clamp)
        sums.append(PixelSums.of(part))
    return tuple(sums)


def breakdowns(
    parts: Iterable[Part],
    rows: Sequence[ReportRow],
    scenes: Mapping[str, str],
    protocol: EvalProtocol,
) -> tuple[Breakdown, ...]:
    """The breakdowns of rows that have the scores of each image, and sums by distance."""
    tables = []
    for part in dict.fromkeys(parts):
        if part is Part.DISTANCE:
            scored = list(_by_distance(rows, distance_ranges(protocol)))
        elif part is Part.SCENE:
            scored = list(_by_scene(rows, scenes))
        else:
            scored = list(_worst(rows))
        tables.append(Breakdown(part, _TITLES[part], tuple(scored)))
    return tuple(tables)


def _by_distance(
    rows: Sequence[ReportRow], ranges: Sequence[tuple[float, float]]
) -> Iterator[PartScores]:
    for i, (near_m, far_m) in enumerate(ranges):
        for row in rows:
            total = reduce(PixelSums.__add__, (sums[i] for sums in row.by_distance))
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
            yield PartScores(kind, _label(row), len(images), mean_of(images))


def _worst(rows: Sequence[ReportRow]) -> Iterator[PartScores]:
    for row in rows:
        scored = [image for image in row.images if np.isfinite(image.scores[_WORST_BY])]
        scored.sort(key=lambda image: image.scores[_WORST_BY], reverse=True)
        for image in scored[:_WORST_COUNT]:
            yield PartScores(image.id, _label(row), 1, image.scores)


def _label(row: ReportRow) -> str:
    return row.name if row.alignment is Alignment.NONE else f"{row.name}, {row.alignment}"
