"""Depth and field of view of point maps."""

import math

import numpy as np
import pytest

from depthcli.inference.points import depth_of_points

SHIFT = 1.5


def points(width: int, height: int, hfov_deg: float) -> np.ndarray:
    """(h, w, 3) of a wavy wall that a camera sees, without ``SHIFT`` in z."""
    focal_px = width / 2 / math.tan(math.radians(hfov_deg) / 2)
    rows, columns = np.mgrid[:height, :width] + 0.5
    z = 3 + np.sin(columns / 9) * 0.5 + rows / height
    x, y = z * (columns - width / 2) / focal_px, z * (rows - height / 2) / focal_px
    return np.stack([x, y, z - SHIFT], -1).astype(np.float32)


@pytest.mark.parametrize("size", [(80, 60), (60, 80), (200, 50)])
@pytest.mark.parametrize("hfov_deg", [30, 60, 100])
def test_shift_and_view_are_those_of_the_camera(size: tuple[int, int], hfov_deg: float) -> None:
    given = points(*size, hfov_deg)
    found = depth_of_points(given)
    np.testing.assert_allclose(found.depth, given[..., 2] + SHIFT, rtol=1e-3)
    assert found.hfov_deg == pytest.approx(hfov_deg, rel=1e-3)


def test_a_known_view_is_kept() -> None:
    found = depth_of_points(points(80, 60, 60), hfov_deg=60)
    assert found.hfov_deg == pytest.approx(60)
    assert np.median(found.depth - points(80, 60, 60)[..., 2]) == pytest.approx(SHIFT, rel=1e-3)


def test_points_without_depth_do_not_count() -> None:
    given = points(80, 60, 60)
    bad = given.copy()
    bad[:20] = 50
    has_depth = np.ones((60, 80), bool)
    has_depth[:20] = False
    assert depth_of_points(bad, has_depth).hfov_deg == pytest.approx(60, rel=1e-3)


def test_nothing_with_depth_is_no_error() -> None:
    found = depth_of_points(points(8, 6, 60), np.zeros((6, 8), bool))
    assert np.isfinite(found.hfov_deg)
