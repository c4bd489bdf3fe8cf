"""From the network's raw output to depth at the picture's size."""

import numpy as np
import numpy.typing as npt

from depthcli.core.choices import Upsampling
from depthcli.core.guided import upsample_guided
from depthcli.core.resize import resize_bilinear
from depthcli.core.types import DepthKind, Frame
from depthcli.inference.preprocess import Layout
from depthcli.models.card_specs import OutputSpec


def coarse_depth(
    spec: OutputSpec, raw: npt.NDArray[np.float32], place: Layout
) -> npt.NDArray[np.float32]:
    """Depth of one picture, (h, w) float32 of the card's kind, of the network's raw output (h, w).

    Without infinities, which a resize would turn into NaN.
    """
    depth = _finite(spec, spec.codec.decode(raw))
    return _crop(depth, place) if place.is_padded else depth


def full_size(
    spec: OutputSpec,
    coarse: npt.NDArray[np.float32],
    frame: Frame,
    upsampling: Upsampling,
    reach: int = 1,
) -> npt.NDArray[np.float32]:
    """Depth at the picture's size.

    Args:
        spec: the card's output.
        coarse: (h, w) float32 of the whole picture.
        frame: the picture.
        upsampling: how its pixels get their depth.
        reach: pixels of ``coarse`` that a pixel of the network's own output is wide.

    Returns:
        (H, W) float32 of the card's kind: metres within the card's range if metric.
    """
    if upsampling is Upsampling.BILINEAR:
        return in_range(spec, resize_bilinear(coarse, frame.width, frame.height))
    coarse = in_range(spec, coarse)
    in_log = blends_in_log(spec)
    return in_range(spec, upsample_guided(coarse, frame, in_log=in_log, reach=reach))


def blends_in_log(spec: OutputSpec) -> bool:
    """Whether depth of this kind is above 0, so that it has a logarithm."""
    return spec.kind is DepthKind.METRIC and spec.min_m is not None and spec.min_m > 0


def in_range(spec: OutputSpec, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Bring metres into the card's range, in place; other kinds have none."""
    if spec.kind is not DepthKind.METRIC:
        return depth
    # A large picture's depth has no room for a copy.
    return np.clip(depth, np.float32(spec.min_m), np.float32(spec.max_m), out=depth)


def _finite(spec: OutputSpec, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Replace infinities before they meet a weight of zero in the resize and become NaN."""
    if not np.isinf(depth).any():
        return depth
    if spec.kind is DepthKind.METRIC:
        return in_range(spec, depth)
    return np.where(np.isinf(depth), np.float32(np.nan), depth)


def _crop(depth: npt.NDArray[np.float32], place: Layout) -> npt.NDArray[np.float32]:
    """Cut the picture out of a letterbox; an output of a lower stride is first brought to size."""
    if depth.shape != (place.height, place.width):
        depth = resize_bilinear(depth, place.width, place.height)
    rows = slice(place.top, place.top + place.inner_height)
    columns = slice(place.left, place.left + place.inner_width)
    return np.ascontiguousarray(depth[rows, columns])
