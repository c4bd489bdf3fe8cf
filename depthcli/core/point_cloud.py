"""Back-projection of a depth map to a point cloud."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthMap, Frame, Provenance, panorama_rays
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


def point_cloud(depth: DepthMap, focal_px: float, frame: Frame | None = None) -> PointCloud:
    """Every pixel with depth as a point, by the pinhole camera, or along the rays of a panorama.

    The focal length is in widths of the map's pixels, the principal point the one that the map
    states, else its middle. The frame gives the colours.
    """
    if not depth.is_metric:
        raise UsageError(
            f"a point cloud needs metres, and {depth.kind} depth has none; fit it to anchors"
        )
    source = depth.provenance or Provenance()
    centre_x, centre_y = source.centre_px or ((depth.width - 1) / 2, (depth.height - 1) / 2)
    valid = depth.valid
    rgb = None if frame is None else frame.pixels_8bit()[valid]
    if source.projection.is_other:
        rays = panorama_rays(depth.width, depth.height)[valid]
        return PointCloud(rays * depth.values[valid][:, np.newaxis], rgb)
    rows, columns = np.nonzero(valid)
    xyz_m = np.empty((len(rows), 3), np.float32)
    xyz_m[:, 2] = depth.values[valid]
    xyz_m[:, 0] = ((np.arange(depth.width) - centre_x) / focal_px)[columns] * xyz_m[:, 2]
    focal_y_px = focal_px * source.pixel_aspect
    xyz_m[:, 1] = ((np.arange(depth.height) - centre_y) / focal_y_px)[rows] * xyz_m[:, 2]
    return PointCloud(xyz_m, rgb)
