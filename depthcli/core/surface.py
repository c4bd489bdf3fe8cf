"""The surface that a metric depth map shows: points, their neighbours, faces, normals, clouds."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import nearest_places
from depthcli.core.types import BoolArray, DepthMap, Float32Array, UInt8Array, panorama_rays

# Chosen on scenes with exact depth: of points more than 10 cm off any surface, one in eight
# stays, and of the others, one in a hundred goes.
_STEEPEST = math.tan(math.radians(82))  # against the image plane
_TORN = math.tan(math.radians(87))  # of one step, where two such pixels are no ramp
_LEAST_REACH, _REACH_SHARE = 5, 1 / 128  # pixels, and of the width: more than an edge is smeared


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A grid of points, one for each pixel, or each n-th of each n-th row."""

    #: (H, W, 3) metres: x right, y down, z along the camera axis; NaN without a point
    xyz_m: Float32Array
    #: (H, W) metres along the camera axis, or along the ray in a panorama; NaN without a point
    depth_m: Float32Array
    #: change of depth between neighbours, by depth, above which they may be on two surfaces
    steepest: float

    @property
    def valid(self) -> BoolArray:
        """(H, W) bool, where there is a point."""
        return ~np.isnan(self.depth_m)

    @property
    def right(self) -> BoolArray:
        """(H, W - 1) bool, whether a point and its right neighbour are on one surface."""
        steps = _steps(self.depth_m)
        return ~(np.isnan(steps) | _stands_out(steps, self.steepest))

    @property
    def down(self) -> BoolArray:
        """(H - 1, W) bool, whether a point and the one below it are on one surface."""
        steps = _steps(self.depth_m.T)
        return ~(np.isnan(steps) | _stands_out(steps, self.steepest)).T

    def faces(self) -> npt.NDArray[np.uint32]:
        """Triangles, (N, 3), of numbers of valid points; counter-clockwise for the camera."""
        numbers = np.cumsum(self.valid, dtype=np.uint32).reshape(self.valid.shape) - np.uint32(1)
        a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, :-1], numbers[1:, 1:]
        upper, lower = self._closed()
        return np.concatenate(
            [np.stack((a, c, b), -1)[upper], np.stack((b, c, d), -1)[lower]], dtype=np.uint32
        )

    def _closed(self) -> tuple[BoolArray, BoolArray]:
        """(H - 1, W - 1) bool each, where four neighbours have an upper and a lower triangle."""
        right, down = self.right, self.down
        return right[:-1] & down[:, :-1], right[1:] & down[:, 1:]

    def gaps(self) -> tuple[npt.NDArray[np.intp], Float32Array]:
        """Rows and columns, (N, 4, 2), of four neighbours between which a triangle is missing.

        Also the points, (N, 4, 3) in metres, that are seen there at the depth of the farthest.
        """
        valid, (upper, lower) = self.valid, self._closed()
        is_whole = valid[:-1, :-1] & valid[:-1, 1:] & valid[1:, :-1] & valid[1:, 1:]
        first = np.argwhere(is_whole & ~(upper & lower))
        places = first[:, np.newaxis] + np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        depth_m = self.depth_m[places[..., 0], places[..., 1]]
        ratio = depth_m.max(1, keepdims=True) / depth_m
        return places, self.xyz_m[places[..., 0], places[..., 1]] * ratio[..., np.newaxis]

    def normals(self) -> Float32Array:
        """Unit normals towards the camera, (H, W, 3) float32, axes as the points; NaN without one.

        A point without neighbours on its surface faces the camera.
        """
        across = _tangents(self.xyz_m, self.right)
        along = _tangents(self.xyz_m.swapaxes(0, 1), self.down.T).swapaxes(0, 1)
        normals = np.cross(along, across)
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        facing = self.xyz_m / -np.linalg.norm(self.xyz_m, axis=-1, keepdims=True)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(length > 0, normals / length, facing), np.float32)


def surface_of(
    depth: DepthMap,
    focal_px: float,
    *,
    stride: int = 1,
    max_depth_m: float | None = None,
    keep_edges: bool = True,
    fill_edges: bool = False,
) -> Surface:
    """Points of a pinhole camera, or along the rays of a panorama.

    The principal point is the one that the map states, else the middle of the map.

    Args:
        depth: a metric map.
        focal_px: focal length in pixels of the map; if they are not square, in widths of them.
        stride: every n-th pixel of every n-th row.
        max_depth_m: pixels beyond have no point; None for no limit.
        keep_edges: whether pixels between near and far, where an edge is smeared, have a point.
        fill_edges: whether they otherwise have that of the nearest other pixel, not none.
    """
    source = depth.provenance
    if source.projection.is_other:
        focal_px = depth.width / (2 * math.pi)
    valid = depth.valid if max_depth_m is None else depth.valid & (depth.values <= max_depth_m)
    depth_m = np.where(valid, depth.values, np.float32(np.nan))
    if not keep_edges:
        flying = is_flying(depth_m, focal_px)
        others = np.where(flying, np.float32(np.nan), depth_m)
        depth_m = others.ravel()[nearest_places(~np.isnan(others))] if fill_edges else others
        depth_m[~valid] = np.nan
    depth_m = depth_m[::stride, ::stride]
    rays = _rays(depth, focal_px)[::stride, ::stride]
    return Surface(rays * depth_m[..., np.newaxis], depth_m, _TORN * stride / focal_px)


def is_flying(depth_m: Float32Array, focal_px: float) -> BoolArray:
    """Pixels on a steep ramp between near and far, or far from both neighbours; (H, W) bool."""
    return _is_ramp(depth_m, focal_px) | _is_ramp(depth_m.T, focal_px).T


def holds_edge(depth_m: Float32Array, focal_px: float) -> bool:
    """Whether a part of a map, (H, W), shows a near surface in front of a far one."""
    torn = (_stands_out(_steps(side), _TORN / focal_px).any() for side in (depth_m, depth_m.T))
    return bool(is_flying(depth_m, focal_px).any() or any(torn))


def _is_ramp(depth_m: Float32Array, focal_px: float) -> BoolArray:
    steps = np.pad(_steps(depth_m), ((0, 0), (1, 1)))
    # The step of a clean edge is on one side of a pixel only.
    return _stands_out(np.minimum(steps[:, :-1], steps[:, 1:]), _STEEPEST / focal_px)


def _steps(depth_m: Float32Array) -> Float32Array:
    """Differences of a row's neighbours by the nearer one's depth; NaN if one has none."""
    left, right = depth_m[:, :-1], depth_m[:, 1:]
    return np.asarray(np.abs(right - left) / np.minimum(left, right), np.float32)


def _stands_out(steps: Float32Array, steepest: float) -> BoolArray:
    """Where steps are too large, and twice those on one side: a road is as steep on both."""
    reach = max(_LEAST_REACH, round(steps.shape[1] * _REACH_SHARE))
    around = np.pad(np.nan_to_num(steps), ((0, 0), (reach, reach)))
    return (steps > steepest) & (
        np.minimum(around[:, : -2 * reach], around[:, 2 * reach :]) < steps / 2
    )


def _tangents(xyz_m: Float32Array, right: BoolArray) -> Float32Array:
    """Sum of the differences to a row's neighbours on the surface, (H, W, 3); 0 without one."""
    steps = np.where(right[..., np.newaxis], np.diff(xyz_m, axis=1), np.float32(0))
    steps = np.pad(steps, ((0, 0), (1, 1), (0, 0)))
    return steps[:, :-1] + steps[:, 1:]


def _rays(depth: DepthMap, focal_px: float) -> Float32Array:
    """Points at a depth of 1, (H, W, 3) float32."""
    source = depth.provenance
    if source.projection.is_other:
        return panorama_rays(depth.width, depth.height)
    centre_x, centre_y = source.centre_px or ((depth.width - 1) / 2, (depth.height - 1) / 2)
    rays = np.ones((depth.height, depth.width, 3), np.float32)
    rays[..., 0] = (np.arange(depth.width) - centre_x) / focal_px
    down = (np.arange(depth.height) - centre_y) / (focal_px * source.pixel_aspect)
    rays[..., 1] = down[:, np.newaxis]
    return rays


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """One point for each pixel with depth, row by row."""

    xyz_m: Float32Array  #: (N, 3) metres: x right, y down, z along the camera axis
    rgb: UInt8Array | None = None  #: (N, 3), of the image; None without one

    def __len__(self) -> int:
        return len(self.xyz_m)

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        return np.array(self.xyz_m, dtype, copy=copy)

    def __repr__(self) -> str:
        colours = "no colours" if self.rgb is None else "colours"
        return f"<PointCloud {len(self)} points, {colours}>"
