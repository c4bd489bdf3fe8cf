"""From the network's raw output to depth at the picture's size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from depthcli.core.resize import resize_bilinear
from depthcli.core.types import DepthKind

if TYPE_CHECKING:
    import numpy.typing as npt

    from depthcli.inference.card import OutputSpec
    from depthcli.inference.preprocess import Layout


def finish(
    spec: OutputSpec, raw: npt.NDArray[np.float32], place: Layout, width: int, height: int
) -> npt.NDArray[np.float32]:
    """Depth of one picture.

    Args:
        spec: the card's output.
        raw: (h, w) float32, the network's output for the whole input.
        place: where the picture lies in that input.
        width: columns of the picture.
        height: rows of the picture.

    Returns:
        (height, width) float32 of the card's kind: metres within the card's range if metric.
    """
    depth = _finite(spec, spec.codec.decode(raw))
    if place.is_padded:
        depth = _crop(depth, place)
    depth = resize_bilinear(depth, width, height)
    if spec.kind is DepthKind.METRIC:
        depth = np.clip(depth, np.float32(spec.min_m), np.float32(spec.max_m))
    return depth


def _finite(spec: OutputSpec, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Replace infinities before they meet a weight of zero in the resize and become NaN."""
    if not np.isinf(depth).any():
        return depth
    if spec.kind is DepthKind.METRIC:
        return np.clip(depth, np.float32(spec.min_m), np.float32(spec.max_m))
    return np.where(np.isinf(depth), np.float32(np.nan), depth)


def _crop(depth: npt.NDArray[np.float32], place: Layout) -> npt.NDArray[np.float32]:
    """Cut the picture out of a letterbox; an output of a lower stride is first brought to size."""
    if depth.shape != (place.height, place.width):
        depth = resize_bilinear(depth, place.width, place.height)
    rows = slice(place.top, place.top + place.inner_height)
    columns = slice(place.left, place.left + place.inner_width)
    return np.ascontiguousarray(depth[rows, columns])
