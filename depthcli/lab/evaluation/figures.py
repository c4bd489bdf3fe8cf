"""Figures of predictions beside input and ground truth, as in the paper's Fig. 2 and 3."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from depthcli.core.arrays import Float32Array, UInt8Array
from depthcli.core.imageops import resize_area, value_channel
from depthcli.core.options import Colormap
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import UsageError
from depthcli.io.formats.preview import PreviewWriter, colour_table, contact_sheet, with_legend
from depthcli.io.images.png import encode_png
from depthcli.lab.datasets.base import DepthDataset
from depthcli.lab.evaluation.predictors import Predictor, Sample
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.task import EvalTask
from depthcli.lab.metrics.alignment import SUITABLE

IMAGES = 6
_CELL_WIDTH_PX = 240
_CLIPPED_PERCENT = 2
_COLORMAP = Colormap.INFERNO
_ALL_DEPTH = EvalProtocol(full_size_px=None, min_m=0.0, max_m=np.inf)


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure."""

    name: str  #: file name without suffix
    caption: str  #: its caption
    png: bytes  #: content of the PNG file


def choose_images(task: EvalTask, ids: Sequence[str] = (), count: int = IMAGES) -> tuple[int, ...]:
    """Positions of the images to show: the given ids, or ``count``, evenly over the scenes."""
    places = dict(zip(task.ids, task.test, strict=True))
    unknown = [name for name in ids if name not in places]
    if unknown:
        message = f"{unknown[0]} is not among the {len(places)} images that are compared"
        raise UsageError(message, "take ids of the split's test part")
    if ids:
        return tuple(places[name] for name in ids)
    by_scene = sorted(task.test, key=lambda i: task.dataset.scenes[i])
    count = min(count, len(by_scene))
    chosen = np.linspace(0, len(by_scene) - 1, 2 * count + 1)[1::2].round().astype(int)
    return tuple(sorted(by_scene[k] for k in chosen))


def draw_figures(
    task: EvalTask,
    positions: Sequence[int],
    predictors: Sequence[tuple[str, Predictor]],
    progress: Progress = NO_PROGRESS,
) -> tuple[Figure, Figure]:
    """Draw figures in gray and in colour: input, a column per (title, predictor), ground truth.

    Every row has the range of its ground truth, to which depth without metres is fitted first.
    """
    advance, rows = progress.begin("drawing images", len(positions)), []
    for position in positions:
        rows.append(_figure_row(task.dataset, position, [predictor for _, predictor in predictors]))
        advance(1)
    columns = ["input", *(title for title, _ in predictors), "truth"]
    ids = ", ".join(task.dataset.ids[i] for i in positions)
    rule = f"images {ids} from top to bottom; each row has the range of its truth"
    gray, coloured = (
        encode_png(contact_sheet([_images_of_row(*row, colours) for row in rows], columns))
        for colours in (Colormap.GRAY, _COLORMAP)
    )
    return (
        Figure("depth-gray", f"Depth in gray, near is white; {rule}.", gray),
        Figure("depth-colour", f"Depth in colour; {rule}, on the right.", coloured),
    )


def _figure_row(
    dataset: DepthDataset, position: int, predictors: Sequence[Predictor]
) -> tuple[UInt8Array, list[DepthMap], tuple[float, float]]:
    """Gray image, predictions and ground truth, and the ends of its range, in metres."""
    sample, truth_m = Sample(dataset, position), dataset.depth_m(position)
    image = np.rint(255 * value_channel(sample.frame.pixels)).astype(np.uint8)
    maps = [_fit_to_truth(predictor.predict(sample), truth_m) for predictor in predictors]
    valid_mask = truth_m > 0
    ends = (_CLIPPED_PERCENT, 100 - _CLIPPED_PERCENT)
    near, far = np.percentile(truth_m[valid_mask] if valid_mask.any() else 1.0, ends)
    truth = DepthMap(np.where(valid_mask, truth_m, np.float32(np.nan)))
    return np.repeat(image[..., None], 3, 2), [*maps, truth], (float(near), float(far))


def _fit_to_truth(depth: DepthMap, truth_m: Float32Array) -> DepthMap:
    """A map of another kind aligned to the ground truth (H, W) float32 metres, 0 for none."""
    if depth.kind is DepthKind.METRIC:
        return depth
    truth, metres = _ALL_DEPTH.truth(truth_m), np.full(truth_m.shape, np.nan, np.float32)
    pixels = _ALL_DEPTH.compare(depth, truth, SUITABLE[depth.kind][0])
    metres[truth.valid] = pixels.prediction
    return DepthMap(metres)


def _images_of_row(
    image: UInt8Array, depths: list[DepthMap], ends_m: tuple[float, float], colormap: Colormap
) -> list[UInt8Array]:
    """The cells of a row, of one size; colours have a legend."""
    (rows, columns), (near, far) = image.shape[:2], ends_m
    writer = PreviewWriter(colormap=colormap, vmin=near, vmax=far)
    size = _CELL_WIDTH_PX, max(1, round(rows * _CELL_WIDTH_PX / columns))
    images = (image, *map(writer.render, depths))
    cells = [np.rint(resize_area(i.astype(np.float32), *size)).astype(np.uint8) for i in images]
    if colormap is not Colormap.GRAY:
        cells[-1] = with_legend(cells[-1], colour_table(colormap), near, far, DepthKind.METRIC)
    return cells
