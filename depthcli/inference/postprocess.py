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
    spec: OutputSpec, raw: npt.NDArray[np.float32], layout: Layout
) -> npt.NDArray[np.float32]:
    """Depth of one picture from the network's raw output (h, w), (h, w) float32 of the card's kind.

    Infinities are replaced, because resizing would turn them into NaN.
    """
    depth = _finite(spec, spec.codec.decode(raw))
    return _crop(depth, layout) if layout.is_padded else depth


def full_size(
    spec: OutputSpec,
    coarse: npt.NDArray[np.float32],
    frame: Frame,
    upsampling: Upsampling,
    radius: int = 1,
) -> npt.NDArray[np.float32]:
    """Depth at the picture's size.

    Args:
        spec: the card's output.
        coarse: (h, w) float32 of the whole picture.
        frame: the picture.
        upsampling: how depth is upsampled.
        radius: of the guided filter, in pixels of ``coarse``.

    Returns:
        (H, W) float32 of the card's kind: metres within the card's range if metric; NaN at 0 m.
    """
    if upsampling is Upsampling.BILINEAR:
        depth = in_range(spec, resize_bilinear(coarse, frame.width, frame.height))
    else:
        coarse, in_log = in_range(spec, coarse), blends_in_log(spec)
        depth = in_range(spec, upsample_guided(coarse, frame, in_log=in_log, radius=radius))
    if spec.kind is DepthKind.METRIC and not blends_in_log(spec):
        depth[depth == 0] = np.nan
    return depth


def blends_in_log(spec: OutputSpec) -> bool:
    """Whether depth of this kind is always above 0, so that its logarithm can be blended."""
    return spec.kind is DepthKind.METRIC and bool(np.float32(spec.min_m or 0) > 0)


def in_range(spec: OutputSpec, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Clip metres to the card's range, in place; other kinds have none."""
    if spec.kind is not DepthKind.METRIC:
        return depth
    # In place, because a copy of a large picture's depth takes much memory.
    return np.clip(depth, np.float32(spec.min_m), np.float32(spec.max_m), out=depth)


def _finite(spec: OutputSpec, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Replace infinities, which a weight of zero in the resize would turn into NaN."""
    if not np.isinf(depth).any():
        return depth
    if spec.kind is DepthKind.METRIC:
        return in_range(spec, depth)
    return np.where(np.isinf(depth), np.float32(np.nan), depth)


def _crop(depth: npt.NDArray[np.float32], layout: Layout) -> npt.NDArray[np.float32]:
    """Crop the picture from a letterbox.

    A smaller output in which the picture does not begin and end with a pixel is first resized to
    the input's size.
    """
    stride = max(1, layout.width // depth.shape[1])
    is_smaller = depth.shape == (layout.height // stride, layout.width // stride)
    if not is_smaller or any(length % stride for length in layout):
        depth, stride = resize_bilinear(depth, layout.width, layout.height), 1
    top, left = layout.top // stride, layout.left // stride
    rows = slice(top, top + layout.inner_height // stride)
    columns = slice(left, left + layout.inner_width // stride)
    return np.ascontiguousarray(depth[rows, columns])
