"""Rooms that are rendered, and their solids."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from depthcli.core.options import Sensor
from depthcli.datasets.rooms.furniture import PIECES
from depthcli.datasets.rooms.materials import Material, Materials
from depthcli.datasets.rooms.render import (
    PinholeCamera,
    Renderer,
    RoomSettings,
    View,
    kinect,
    place_camera,
    render_pair,
    room_focal_px,
)
from depthcli.datasets.rooms.room import ROOM_TYPES, Light, Room, make_room
from depthcli.datasets.rooms.solids import CYLINDER_Y, SPHERE, Part, Solids, box, intersect

SMALL = RoomSettings(size=(64, 48))


@pytest.fixture(scope="module")
def rooms() -> list[Room]:
    return [make_room(np.random.default_rng([5, i]), kind) for i in range(5) for kind in ROOM_TYPES]


def test_every_piece_of_furniture_appears(rooms: list[Room]) -> None:
    assert {name for room in rooms for name in room.names} == set(PIECES)


def test_layouts_are_of_all_shapes(rooms: list[Room]) -> None:
    shells = [room.shell for room in rooms]
    assert any(shell.corner for shell in shells)
    assert any(not shell.windows for shell in shells)
    assert {room.is_day for room in rooms} == {False, True}
    long = [max(shell.width, shell.depth) for shell in shells]
    assert min(long) < 4
    assert 8 < max(long) <= 12
    materials = [part.material for room in rooms for part in room.solids.parts]
    assert any(material.specular > 0.9 for material in materials)
    assert any(material.emission for material in materials)


@pytest.mark.parametrize("name", PIECES)
def test_furniture_stands_in_its_footprint(name: str) -> None:
    random = np.random.default_rng(8)
    materials = Materials(random)
    for _ in range(4):
        piece = PIECES[name](random, materials)
        reach = [np.abs(part.axes.T) @ part.half for part in piece.parts]
        low = np.min([np.array(p.centre) - r for p, r in zip(piece.parts, reach, strict=True)], 0)
        high = np.max([np.array(p.centre) + r for p, r in zip(piece.parts, reach, strict=True)], 0)
        assert low[1] > -0.03
        assert np.abs([low[0], high[0]]).max() < piece.width / 2 + 0.25
        assert -0.25 < low[2] < high[2] < piece.depth + 0.25
        assert piece.top <= high[1] + 1e-6


def test_things_stand_on_the_floor_inside_the_walls(rooms: list[Room]) -> None:
    for room in rooms:
        for low_x, high_x, low_z, high_z in room.occupied:
            assert low_x >= 0 <= low_z
            assert high_x <= room.shell.width
            assert high_z <= room.shell.depth


def test_a_picture_follows_from_seed_and_number_alone() -> None:
    first, again = render_pair(SMALL, 3), render_pair(SMALL, 3)
    render_pair(SMALL, 2)
    for other in (again, render_pair(SMALL, 3)):
        np.testing.assert_array_equal(first.rgb, other.rgb)
        np.testing.assert_array_equal(first.depth_m, other.depth_m)
    assert (first.rgb != render_pair(SMALL._replace(seed=1), 3).rgb).any()
    assert first.rgb.shape == (48, 64, 3)
    assert first.depth_m.shape == (48, 64)


def test_pictures_have_light_and_depth() -> None:
    pairs = [render_pair(SMALL, i) for i in range(12)]
    medians = [float(np.median(pair.depth_m[pair.depth_m > 0])) for pair in pairs]
    assert 0.4 < min(medians) < 2.2 < max(medians) < 8
    assert all(40 < pair.rgb.max(-1).mean() < 220 for pair in pairs)
    assert all(pair.rgb.max(-1).std() > 8 for pair in pairs)


def test_focal_lengths_are_in_the_range_that_is_asked_for() -> None:
    angles = [2 * math.degrees(math.atan(32 / room_focal_px(SMALL, i))) for i in range(200)]
    assert 30 <= min(angles) < 40
    assert 100 < max(angles) <= 110
    exact = SMALL._replace(hfov_deg=(63.3, 63.3))
    assert room_focal_px(exact, 7) == pytest.approx(32 / math.tan(math.radians(31.65)))


def scene(*things: Part) -> tuple[Renderer, Room]:
    """What stands before a camera at the origin that looks along z, in a lamp's light."""
    random = np.random.default_rng(0)
    room = make_room(random, "office")
    room.is_day = True
    room.lights[:] = [Light((0, 3, 0), ((0.1, 0, 0), (0, 0, 0.1)), 20.0, (1, 1, 1))]
    camera = PinholeCamera((0, 0, 0), np.eye(3, dtype=np.float32), 32.0, 64, 48)
    return Renderer(room, Solids([list(things)]), camera, random), room


def test_a_mirror_shows_what_is_before_it_and_has_the_depth_of_its_glass() -> None:
    materials = Materials(np.random.default_rng(0))
    black = materials.black._replace(dark=(0, 0, 0), light=(0, 0, 0))
    mirror = box((-2, 2), (-2, 2), (3, 3.1), black._replace(specular=1.0))
    shining = Part((0, 0, -2), (1, 1, 0.1), materials.lamp, SPHERE)
    view = scene(mirror, shining)[0].view()
    np.testing.assert_allclose(view.depth_m[8:-8, 12:-12], 3, rtol=1e-5)
    shown = view.light.max(-1) > 2
    assert shown[24, 32]
    assert shown[:, :20].mean() < 0.02 < shown[16:32, 24:40].mean()


def test_the_outdoors_is_bright_and_has_no_depth() -> None:
    wall = scene(box((-9, 0), (-9, 9), (3, 3.1), Materials(np.random.default_rng(0)).white))[
        0
    ].view()
    assert (wall.depth_m[:, 33:] == 0).all()
    assert (wall.depth_m[:, :31] > 2.9).all()
    assert wall.light[:20, 40:].mean() > wall.light[:20, :20].mean()


def test_things_throw_shadows() -> None:
    materials = Materials(np.random.default_rng(0))
    floor = box((-9, 9), (-1.2, -1), (0, 9), materials.white)
    roof = box((-0.6, 0.6), (0.5, 0.6), (1, 3), materials.white)
    light = scene(floor, roof)[0].view().light[-8, :, 1]
    assert light[32] < 0.7 * light[4]


def flat(depth_m: float, **facts: float) -> View:
    shape = (240, 320)
    of = {"specular": 0.0, "slant": 1.0} | facts
    return View(
        np.zeros((*shape, 3), np.float32),
        np.full(shape, depth_m, np.float32),
        *(np.full(shape, of[name], np.float32) for name in ("specular", "slant")),
    )


def measured(view: View, focal_px: float = 259.3) -> npt.NDArray[np.float32]:
    return kinect(view, focal_px, np.random.default_rng(1))


def test_the_noise_of_a_kinect_grows_with_the_square_of_the_distance() -> None:
    near, far = (measured(flat(z)) for z in (1.5, 4.5))
    assert np.median(near) == pytest.approx(1.5, rel=0.01)
    assert np.median(far) == pytest.approx(4.5, rel=0.01)
    assert 5 < far[far > 0].std() / near[near > 0].std() < 14
    assert 0.004 < far[far > 0].std() < 0.08


@pytest.mark.parametrize("view", [flat(0.3), flat(12), flat(2, specular=0.9), flat(2, slant=0.05)])
def test_a_kinect_does_not_see_what_is_near_far_shiny_or_grazing(view: View) -> None:
    assert (measured(view) == 0).mean() > 0.6


def test_the_shadow_of_a_thing_is_as_wide_as_the_thing_at_most() -> None:
    """Behind a post 3 pixels wide, the wall is seen again between the post and its shadow."""
    view = flat(4.0)
    view.depth_m[:, 150:153] = 1.0
    shaded = (measured(view) == 0).mean(0) > 0.6
    assert 2 <= shaded[120:180].sum() <= 6


def test_the_shadow_is_narrower_for_a_wider_lens() -> None:
    view = flat(4.0)
    view.depth_m[:, 100:200] = 1.0
    widths = [(measured(view, focal_px) == 0).mean(0)[60:240] for focal_px in (260.0, 130.0)]
    narrow, wide = (int((share > 0.6).sum()) for share in widths)
    expected = 0.075 * 260 * (1 / 1 - 1 / 4)
    assert narrow == pytest.approx(expected, abs=3)
    assert wide == pytest.approx(expected / 2, abs=3)


def test_the_outdoors_casts_no_shadow() -> None:
    view = flat(3.0)
    view.depth_m[:, 120:200] = 0.0
    holes = measured(view) == 0
    assert holes[:, 125:195].all()
    assert np.delete(holes, slice(115, 205), axis=1).mean() < 0.1


def test_the_sensor_changes_depth_alone() -> None:
    exact, noisy = (render_pair(SMALL._replace(sensor=s), 1) for s in Sensor)
    np.testing.assert_array_equal(exact.rgb, noisy.rgb)
    both = (exact.depth_m > 0) & (noisy.depth_m > 0)
    assert (noisy.depth_m == 0).sum() > (exact.depth_m == 0).sum()
    off = np.abs(noisy.depth_m - exact.depth_m)[both]
    assert 0 < np.median(off) < 0.05


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
    for plane in planes:
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
