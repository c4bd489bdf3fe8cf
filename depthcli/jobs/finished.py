"""The last steps from a model's depth map to the one that is written."""

from depthcli.core.anchor_fit import fitted, lost_in_fit
from depthcli.core.anchors import AnchorPoints
from depthcli.core.map_camera import with_centre
from depthcli.core.overscan import masked_to_data_window
from depthcli.core.summary import flat_warnings
from depthcli.core.types import DepthMap
from depthcli.core.windows import Windows


def finished_depth(
    depth: DepthMap,
    windows: Windows | None,
    points: AnchorPoints | None,
    centre_px: tuple[float, float] | None,
) -> tuple[DepthMap, tuple[str, ...]]:
    """Depth of a picture, fitted to known points, and warnings about it and the fit.

    Args:
        depth: of all pixels of the picture's frame.
        windows: of the frame; None if its file has all of them.
        points: known depth; None to keep the metres of the model.
        centre_px: principal point in pixels of the map; None for its middle.

    Raises:
        InputError: the points do not fit this picture.
    """
    flat = flat_warnings(depth)
    depth = masked_to_data_window(depth, windows)
    found = with_centre(fitted(depth, points, windows), centre_px)
    return found, (*flat, *(points.warnings if points else ()), *lost_in_fit(depth, found))
