"""Points of a depth map, by the pinhole camera."""

import numpy as np
import pytest

from depthcli.core.camera import Intrinsics
from depthcli.core.surface import point_cloud
from depthcli.core.types import DepthKind, DepthMap, Frame, with_camera
from depthcli.errors import UsageError

DEPTH = DepthMap(np.float32([[1, 2, np.nan], [0, np.inf, 4]]))


def test_each_pixel_with_depth_is_a_point_on_its_ray() -> None:
    cloud = point_cloud(DEPTH, 10.0)
    rays = np.array([[-1, -0.5, 10], [0, -0.5, 10], [1, 0.5, 10]]) / 10  # about (1, 0.5)
    np.testing.assert_allclose(cloud.xyz_m, rays * [[1], [2], [4]], rtol=1e-6)
    assert (len(cloud), cloud.rgb) == (3, None)
    np.testing.assert_array_equal(np.asarray(cloud), cloud.xyz_m)
    moved = point_cloud(with_camera(DEPTH, Intrinsics(centre_px=(0.0, 1.0))), 10.0)
    rays = np.array([[0, -1, 10], [1, -1, 10], [2, 0, 10]]) / 10
    np.testing.assert_allclose(moved.xyz_m, rays * [[1], [2], [4]], rtol=1e-6)


def test_points_have_the_colours_of_their_pixels() -> None:
    pixels = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    cloud = point_cloud(DEPTH, 10.0, frame=Frame(pixels))
    assert cloud.rgb is not None
    np.testing.assert_array_equal(cloud.rgb, pixels[[0, 0, 1], [0, 1, 2]])
    assert repr(cloud) == "<PointCloud 3 points, colours>"


def test_points_are_thinned_and_far_ones_left_out() -> None:
    values = np.arange(1, 31, dtype=np.float32).reshape(5, 6)
    pixels = np.arange(90, dtype=np.uint8).reshape(5, 6, 3)
    cloud = point_cloud(DepthMap(values), 10.0, Frame(pixels), stride=2, max_depth_m=15)
    np.testing.assert_array_equal(cloud.xyz_m[:, 2], [1, 3, 5, 13, 15])
    assert cloud.rgb is not None
    np.testing.assert_array_equal(cloud.rgb, pixels[::2, ::2].reshape(-1, 3)[:5])
    ramp = np.broadcast_to(np.float32([1] * 9 + [2, 3] + [4] * 9), (9, 20)).copy()
    edged = point_cloud(DepthMap(ramp), 100.0, keep_edges=False)
    assert set(edged.xyz_m[:, 2]) == {1, 4}


def test_map_without_metres_has_no_points() -> None:
    with pytest.raises(UsageError):
        point_cloud(DepthMap(DEPTH.values, DepthKind.RELATIVE), 10.0)
