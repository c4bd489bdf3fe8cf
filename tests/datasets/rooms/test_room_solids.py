"""Rays against solids: the vectorized search and one ray, one solid, one bound at a time."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from depthcli.datasets.rooms.materials import Material
from depthcli.datasets.rooms.render import place_camera
from depthcli.datasets.rooms.room import make_room
from depthcli.datasets.rooms.solids import CYLINDER_Y, SPHERE, Part, Solids, box, intersect

GRAY = Material(0, (0.0, 0.0, 0.0), (0.5, 0.5, 0.5))


def first_hit(parts: list[Part], eye: npt.NDArray, ray: npt.NDArray) -> float:
    """How far a ray goes in float64, clipped at every plane and at the roots of quadrics."""
    hits = [span[0] for part in parts if (span := inside(part, eye, ray)) and span[0] > 0]
    return min(hits, default=math.inf)


def inside(part: Part, eye: npt.NDArray, ray: npt.NDArray) -> tuple[float, float] | None:
    start = part.axes @ (eye - np.array(part.centre)) / np.array(part.half)
    step = part.axes @ ray / np.array(part.half)
    first, last = -math.inf, math.inf
    planes = [sign * row for row in np.eye(3) for sign in (1, -1)]
    for plane in [*planes, *map(np.array, part.cuts)]:
        room, speed = 1 - plane @ start, plane @ step
        if speed > 0:
            last = min(last, room / speed)
        elif speed < 0:
            first = max(first, room / speed)
        elif room < 0:
            return None
    if any(part.quadric):
        weight = np.array(part.quadric)
        powers = [weight @ step**2, 2 * weight @ (start * step), weight @ start**2 - 1]
        roots = np.sort_complex(np.roots(powers))
        if len(roots) == 2 and not np.isrealobj(roots) and np.abs(roots.imag).max() > 0:
            return None
        if len(roots) == 2:
            first, last = max(first, roots[0].real), min(last, roots[1].real)
        elif powers[2] > 0:
            return None
    return (first, last) if first < last else None


@pytest.mark.parametrize("number", range(4))
def test_depth_is_that_of_one_ray_at_a_time(number: int) -> None:
    random = np.random.default_rng([9, number])
    room = make_room(random, ("office", "living", "bathroom", "kitchen")[number])
    solids = room.solids
    camera = place_camera(random, room, solids, 12.0, (16, 12))
    rays = camera.rays()
    found = solids.cast(camera.origin, rays)
    some = range(number, rays.shape[1], 5)
    eye = camera.origin[:, 0].astype(float)
    truth = [first_hit(solids.parts, eye, rays[:, i].astype(float)) for i in some]
    np.testing.assert_allclose(found.distance[some], truth, rtol=1e-4)
    assert len(np.unique(found.solid[some])) > 4


def test_rays_of_a_camera_are_one_long_along_its_axis() -> None:
    random = np.random.default_rng(3)
    room = make_room(random)
    camera = place_camera(random, room, room.solids, 20.0, (16, 12))
    np.testing.assert_allclose(camera.orientation[:, 2] @ camera.rays(), 1, rtol=1e-6)


def test_depth_of_a_plane_is_that_of_a_plane() -> None:
    """1 / z is an affine function of the pixel, without steps where rays are searched in parts."""
    random = np.random.default_rng(0)
    room = make_room(random, "hall")
    solids = Solids([[box((-50, 50), (-1, 0), (-50, 50), GRAY)]])
    camera = place_camera(random, room, room.solids, 150.0, (160, 120))
    hits = solids.cast(camera.origin, camera.rays())
    seen = hits.solid == 0
    assert seen.sum() > 2000
    row, column = np.divmod(np.arange(160 * 120), 160)
    pixels = np.stack([row, column, np.ones(row.size)], 1)[seen]
    nearness = 1 / hits.distance[seen].astype(float)
    fit = np.linalg.lstsq(pixels, nearness, rcond=None)[0]
    np.testing.assert_allclose(pixels @ fit, nearness, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("part", "ray", "distance", "normal"),
    [
        (Part((0, 0, 3), (1, 1, 1), GRAY), (0.1, 0.1, 1), 2.0, (0, 0, -1)),
        (Part((0, 0, 3), (1, 1, 1), GRAY, SPHERE), (0, 0, 1), 2.0, (0, 0, -1)),
        (Part((0, 0, 3), (1, 2, 1), GRAY, CYLINDER_Y), (0, 0.3, 1), 2.0, (0, 0, -1)),
        (Part((0, -2, 3), (1, 1, 1), GRAY, CYLINDER_Y), (0, -0.4, 1), 2.5, (0, 1, 0)),
        (Part((0, 0, 3), (1, 1, 1), GRAY, cuts=((0, 0, -2.0),)), (0, 0, 1), 2.5, (0, 0, -1)),
        (Part((0, 0, 3), (1, 1, 1), GRAY).tilted(45, 1), (0.01, 0, 1), 1.6, None),
    ],
)
def test_ray_has_distance_and_normal(
    part: Part, ray: tuple[float, ...], distance: float, normal: tuple[float, ...] | None
) -> None:
    solids, rays = Solids([[part]]), np.array([ray, (0, 1, -1)], np.float32).T
    hits = solids.cast(np.zeros((3, 1), np.float32), rays)
    assert hits.distance[0] == pytest.approx(distance, rel=0.01)
    assert list(hits.solid) == [0, -1]
    if normal:
        found = intersect(solids, np.zeros((3, 1), np.float32), rays).normal
        np.testing.assert_allclose(found[:, 0], normal, atol=1e-5)


def test_a_ray_ends_at_its_reach() -> None:
    solids = Solids([[Part((0, 0, 3), (1, 1, 1), GRAY)]])
    ahead = np.array([[0], [0], [1]], np.float32)
    assert solids.cast(np.zeros((3, 1), np.float32), ahead, 1.9).solid[0] == -1
    assert solids.cast(np.zeros((3, 1), np.float32), ahead, 2.1).solid[0] == 0
