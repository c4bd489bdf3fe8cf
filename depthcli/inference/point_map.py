"""Depth and field of view of an affine point map: points up to a shift along the camera axis.

The pixel (u, v) of a pinhole camera sees a point (x, y, z) if (u, v) = f (x, y) / (z + shift). The
shift and f that fit a grid of points best are found by least squares. Source: Wang et al., "MoGe",
arXiv:2410.19115, and ``recover_focal_shift`` of https://github.com/microsoft/MoGe.
"""

import math

import numpy as np

from depthcli.core.types import BoolArray, Float32Array, Float64Array

_GRID = 64  # rows and columns of points that are fitted
_LEAST_POINTS = 2
_STEPS = 50
_DAMPING = 1e-3
_SETTLED = 1e-9


def depth_of_points(
    points: Float32Array, has_depth: BoolArray | None = None, hfov_deg: float | None = None
) -> tuple[Float32Array, float]:
    """Depth of a point map (h, w, 3) of square pixels, whose x is to the right and y is down.

    Returns:
        z and the shift, (h, w), and the horizontal field of view in degrees, fitted if it is None.
        Points are fitted where ``has_depth`` (h, w), None for everywhere.
    """
    height, width = points.shape[:2]
    diagonal = math.hypot(width, height)
    rows, columns = (np.arange(_GRID) * length // _GRID for length in (height, width))
    u, v = (2 * columns + 1 - width) / diagonal, (2 * rows + 1 - height) / diagonal
    directions = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1).reshape(-1, 2)
    grid = points[np.ix_(rows, columns)].reshape(-1, 3).astype(np.float64)
    if has_depth is not None:
        chosen = has_depth[np.ix_(rows, columns)].ravel()
        directions, grid = directions[chosen], grid[chosen]
    fixed = None if hfov_deg is None else width / diagonal / math.tan(math.radians(hfov_deg) / 2)
    shift, focal = 0.0, fixed or 1.0
    if len(grid) >= _LEAST_POINTS:
        shift = _best_shift(directions, grid, fixed)
        focal = _focal(directions, grid, shift, fixed)
    view_rad = 2 * math.atan2(width / diagonal, focal)
    return points[..., 2] + np.float32(shift), math.degrees(view_rad)


def _focal(rays: Float64Array, grid: Float64Array, shift: float, fixed: float | None) -> float:
    """The focal length by half the diagonal that fits a shift best."""
    if fixed is not None:
        return fixed
    flat = grid[:, :2] / (grid[:, 2:] + shift)
    return float((flat * rays).sum() / (flat * flat).sum())


def _best_shift(rays: Float64Array, grid: Float64Array, fixed: float | None) -> float:
    """The shift of least squares, by Levenberg's and Marquardt's steps from 0."""

    def errors(shift: float) -> Float64Array:
        flat = grid[:, :2] / (grid[:, 2:] + shift)
        return (_focal(rays, grid, shift, fixed) * flat - rays).ravel()

    shift, damping, now = 0.0, _DAMPING, errors(0.0)
    step_size = 1e-6 * max(1.0, float(np.abs(grid[:, 2]).mean()))
    for _ in range(_STEPS):
        slope = (errors(shift + step_size) - errors(shift - step_size)) / (2 * step_size)
        change = -float(slope @ now) / (float(slope @ slope) * (1 + damping) or 1.0)
        then = errors(shift + change)
        if not float(then @ then) <= float(now @ now):
            damping *= 10
            continue
        shift, now, damping = shift + change, then, damping / 10
        if abs(change) <= _SETTLED * max(1.0, abs(shift)):
            break
    return shift
