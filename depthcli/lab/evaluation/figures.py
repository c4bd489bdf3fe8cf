"""Figures of predictions beside input and ground truth, as in the paper's Fig. 2 and 3."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from depthcli.core.imageops import resize_area, value_channel
from depthcli.core.options import Colormap
from depthcli.core.parallel import NO_PROGRESS, Progress
from depthcli.core.types import DepthKind, DepthMap, Float32Array, UInt8Array
from depthcli.errors import UsageError
from depthcli.io.formats.preview import PreviewWriter, colour_table, with_legend
from depthcli.io.images.png import encode_png
from depthcli.lab.datasets.base import DepthDataset
from depthcli.lab.evaluation.predictors import Predictor, Sample
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.task import EvalTask
from depthcli.lab.metrics.alignment import SUITABLE

_FONT, _SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.5  # of a title
_BACKGROUND, _TEXT_COLOUR = 255, (24, 24, 24)
_GAP_PX, _TITLE_PX = 4, 26

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


def contact_sheet(rows: Sequence[Sequence[UInt8Array]], titles: Sequence[str]) -> UInt8Array:
    """Arrange images (H, W, 3) RGB uint8 on a white sheet, (H', W', 3) RGB uint8.

    A column is as wide as its widest image, a row as high as its highest. In the titles of the
    columns, characters beyond ASCII become "?".
    """
    widths = [max(p.shape[1] for p in column) for column in zip(*rows, strict=True)]
    heights = [max(image.shape[0] for image in row) for row in rows]
    lefts = [_GAP_PX + sum(widths[:i]) + i * _GAP_PX for i in range(len(widths))]
    tops = [_TITLE_PX + sum(heights[:i]) + i * _GAP_PX for i in range(len(heights))]
    size = (tops[-1] + heights[-1] + _GAP_PX, lefts[-1] + widths[-1] + _GAP_PX, 3)
    sheet = np.full(size, _BACKGROUND, np.uint8)
    for title, left, width in zip(titles, lefts, widths, strict=True):
        sheet[:_TITLE_PX, left : left + width] = _title(title, width)
    for row, top in zip(rows, tops, strict=True):
        for image, left in zip(row, lefts, strict=True):
            height, width = image.shape[:2]
            sheet[top : top + height, left : left + width] = image
    return sheet


def _title(text: str, width: int) -> UInt8Array:
    """(26, width, 3): the text in the middle, smaller if it is long."""
    text = text.encode("ascii", "replace").decode()
    band = np.full((_TITLE_PX, width, 3), _BACKGROUND, np.uint8)
    (text_width, _), _ = cv2.getTextSize(text, _FONT, _SIZE, 1)
    size = _SIZE * min(1.0, (width - 2) / max(text_width, 1))
    (text_width, text_height), _ = cv2.getTextSize(text, _FONT, size, 1)
    origin = ((width - text_width) // 2, (_TITLE_PX + text_height) // 2)
    cv2.putText(band, text, origin, _FONT, size, _TEXT_COLOUR, 1, cv2.LINE_AA)
    return band
