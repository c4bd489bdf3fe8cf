"""The surface of a depth map: its edges, faces, normals and points."""

import itertools
import math

import numpy as np
import pytest
from helpers.tiny import point_cloud

from depthcli.core.camera import Intrinsics
from depthcli.core.surface import holds_edge, is_flying, surface_of
from depthcli.core.types import DepthMap, Frame, with_camera

FOCAL_PX = 100.0


def box_before_wall() -> np.ndarray:
    """A box at 1 m before a wall at 3 m; (60, 80) float32."""
    depth_m = np.full((60, 80), 3, np.float32)
    depth_m[20:40, 30:50] = 1
    return depth_m


def test_faces_join_points_of_one_surface_and_look_at_the_camera() -> None:
    depth_m = box_before_wall()[15:45, 25:40]
    depth_m[2, 3] = np.nan
    surface = surface_of(DepthMap(depth_m), FOCAL_PX)
    numbers = {tuple(place): n for n, place in enumerate(np.argwhere(surface.valid))}
    expected = []
    for y, x in np.ndindex(29, 14):
        a, b, c, d = (y, x), (y, x + 1), (y + 1, x), (y + 1, x + 1)
        triangles = (t for t in ((a, c, b), (b, c, d)) if len({depth_m[place] for place in t}) == 1)
        expected += [[numbers[place] for place in triangle] for triangle in triangles]
    faces = surface.faces()
    assert sorted(faces.tolist()) == sorted(expected)
    a, b, c = surface.xyz_m[surface.valid][faces].swapaxes(0, 1)
    assert (np.cross(b - a, c - a)[:, 2] < 0).all()


def plain_steps(line: np.ndarray) -> list[np.float32]:
    """Differences of neighbours by the nearer one's depth; NaN without one."""
    return [abs(b - a) / np.minimum(a, b) for a, b in itertools.pairwise(line)]


def stand_out(steps: list[np.float32], degrees: float) -> list[bool]:
    """Which steps are steeper than an angle, and twice those some pixels away on one side."""
    steepest, reach = math.tan(math.radians(degrees)) / FOCAL_PX, max(5, round(len(steps) / 128))
    away = [0] * reach + [max(0, step) for step in steps] + [0] * reach
    sides = zip(away, away[2 * reach :], strict=False)
    return [
        step > steepest and min(side) < step / 2 for step, side in zip(steps, sides, strict=True)
    ]


def flying(line: np.ndarray) -> list[bool]:
    """Pixels between two steep steps of a line."""
    return stand_out(
        list(itertools.starmap(np.minimum, itertools.pairwise([0, *plain_steps(line), 0]))), 82
    )


@pytest.mark.parametrize("shape", [(5, 900), (30, 12), (3, 2)])
@pytest.mark.parametrize("spread", [0.03, 0.2])
def test_edges_are_those_of_a_plain_loop(shape: tuple[int, int], spread: float) -> None:
    random = np.random.default_rng(0)
    depth_m = np.exp(random.normal(0, spread, shape)).astype(np.float32)
    depth_m[random.random(shape) < 0.05] = np.nan
    surface, torn = surface_of(DepthMap(depth_m), FOCAL_PX), []
    for edges, lines in ((surface.right, depth_m), (surface.down.T, depth_m.T)):
        steps = [plain_steps(line) for line in lines]
        torn += [stand_out(line, 87) for line in steps]
        expected = [
            [np.isfinite(step) and not out for step, out in zip(*both, strict=True)]
            for both in zip(steps, torn[-len(steps) :], strict=True)
        ]
        np.testing.assert_array_equal(edges, expected)
    across, down = [[flying(line) for line in lines] for lines in (depth_m, depth_m.T)]
    np.testing.assert_array_equal(is_flying(depth_m, FOCAL_PX), across | np.transpose(down))
    assert holds_edge(depth_m, FOCAL_PX) == any(map(any, (*across, *down, *torn)))


def test_gaps_are_seen_at_the_depth_of_the_farthest() -> None:
    depth_m = np.ones((4, 6), np.float32)
    depth_m[1:, 3:], depth_m[1, 1] = 3, np.nan
    surface = surface_of(DepthMap(depth_m), FOCAL_PX)
    places, points_m = surface.gaps()
    corners = [(y, x) for y, x in np.ndindex(3, 5) if np.ptp(depth_m[y : y + 2, x : x + 2]) > 0]
    assert places.tolist() == [[[y, x], [y, x + 1], [y + 1, x], [y + 1, x + 1]] for y, x in corners]
    for (y, x), point_m in zip(places.reshape(-1, 2), points_m.reshape(-1, 3), strict=True):
        assert point_m == pytest.approx(surface.xyz_m[y, x] * 3 / depth_m[y, x])


def test_each_pixel_with_depth_is_a_point_on_its_ray() -> None:
    depth = DepthMap(np.float32([[1, 2, np.nan], [0, np.inf, 4]]))
    cloud = point_cloud(depth, 10.0)
    rays = np.array([[-1, -0.5, 10], [0, -0.5, 10], [1, 0.5, 10]]) / 10  # about (1, 0.5)
    np.testing.assert_allclose(cloud.xyz_m, rays * [[1], [2], [4]], rtol=1e-6)
    assert (len(cloud), cloud.rgb) == (3, None)
    np.testing.assert_array_equal(np.asarray(cloud), cloud.xyz_m)
    camera = Intrinsics(centre_px=(0.0, 1.0), pixel_aspect=2.0)
    moved = point_cloud(with_camera(depth, camera), 10.0)
    rays = np.array([[0, -0.5, 10], [1, -0.5, 10], [2, 0, 10]]) / 10
    np.testing.assert_allclose(moved.xyz_m, rays * [[1], [2], [4]], rtol=1e-6)


def test_normals_do_not_look_across_edges() -> None:
    depth_m = box_before_wall()
    depth_m[:3, :3] = np.nan
    depth_m[1, 1] = 2  # without a neighbour, it faces the camera
    surface = surface_of(DepthMap(depth_m), FOCAL_PX)
    normals = surface.normals()
    alone = surface.xyz_m[1, 1] / np.linalg.norm(surface.xyz_m[1, 1])
    np.testing.assert_allclose(normals[1, 1], -alone, rtol=1e-5)
    surface.depth_m[1, 1] = np.nan
    flat = normals[surface.valid]
    np.testing.assert_allclose(flat, np.broadcast_to([0, 0, -1], flat.shape), atol=1e-6)


def test_points_with_colours_are_thinned_and_far_ones_left_out() -> None:
    values = np.arange(1, 31, dtype=np.float32).reshape(5, 6)
    pixels = np.arange(90, dtype=np.uint8).reshape(5, 6, 3)
    cloud = point_cloud(DepthMap(values), 10.0, Frame(pixels), stride=2, max_depth_m=15)
    np.testing.assert_array_equal(cloud.xyz_m[:, 2], [1, 3, 5, 13, 15])
    np.testing.assert_array_equal(cloud.rgb, pixels[::2, ::2].reshape(-1, 3)[:5])
    assert repr(cloud) == "<PointCloud 5 points, colours>"
    ramp = np.broadcast_to(np.float32([1] * 9 + [2, 3] + [4] * 9), (9, 20)).copy()
    edged = point_cloud(DepthMap(ramp), 100.0, keep_edges=False)
    assert (set(edged.xyz_m[:, 2]), len(edged)) == ({1, 4}, 18 * 9)
    assert len(point_cloud(DepthMap(ramp), 100.0)) == ramp.size
    ramp[0, 0] = np.nan
    filled = surface_of(DepthMap(ramp), 100.0, keep_edges=False, fill_edges=True).depth_m
    np.testing.assert_array_equal(filled, np.where(ramp < 2.5, 1, np.where(ramp > 2.5, 4, ramp)))
