"""Back-projection of a depth map to a point cloud."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.surface import surface_of
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import UsageError


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """One point for each pixel with depth, row by row."""

    xyz_m: npt.NDArray[np.float32]  #: (N, 3) metres: x right, y down, z along the camera axis
    rgb: npt.NDArray[np.uint8] | None = None  #: (N, 3), of the picture; None without one

    def __len__(self) -> int:
        return len(self.xyz_m)

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        return np.array(self.xyz_m, dtype, copy=copy)

    def __repr__(self) -> str:
        colours = "no colours" if self.rgb is None else "colours"
        return f"<PointCloud {len(self)} points, {colours}>"


def point_cloud(
    depth: DepthMap,
    focal_px: float,
    frame: Frame | None = None,
    *,
    stride: int = 1,
    max_depth_m: float | None = None,
    keep_edges: bool = True,
) -> PointCloud:
    """Pixels with depth as points, by the pinhole camera, or along the rays of a panorama.

    The focal length is in widths of the map's pixels, the principal point the one that the map
    states, else its middle. The frame gives the colours.
    """
    if not depth.is_metric:
        raise UsageError(
            f"a point cloud needs metres, and {depth.kind} depth has none; fit it to anchors"
        )
    surface = surface_of(
        depth, focal_px, stride=stride, max_depth_m=max_depth_m, keep_edges=keep_edges
    )
    rgb = None if frame is None else frame.pixels_8bit()[::stride, ::stride][surface.valid]
    return PointCloud(surface.xyz_m[surface.valid], rgb)
