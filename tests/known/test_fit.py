"""Fitting depth to known points, globally and locally."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from depthcli.core.camera import Anchor as Point
from depthcli.core.options import DepthFit
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError, UsageError
from depthcli.known import local_correction
from depthcli.known.points import KnownDepth, fit_known_depth, fitted

RANDOM = np.random.default_rng(3)


def fitted_map(depth: DepthMap, points: list[Point] | KnownDepth) -> DepthMap:
    return fit_known_depth(depth, points)[0]


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_anchors_recover_scale_and_shift(kind: DepthKind) -> None:
    truth_m = RANDOM.uniform(1, 9, (8, 10))
    values = 1 / truth_m if kind is DepthKind.INVERSE else truth_m
    depth = DepthMap(((values - 0.05) / 1.7).astype(np.float32), kind)
    points = [Point(x, y, float(truth_m[y, x])) for x, y in [(0, 0), (9, 7), (4, 2)]]
    fitted = fitted_map(depth, points)
    assert fitted.kind is DepthKind.METRIC
    assert fitted.values == pytest.approx(truth_m, rel=1e-3)


def test_two_anchors_of_similar_depth_do_not_move_a_metric_map_far() -> None:
    """A line through both would be 30 x - 59: the far wall at 61 m, the table behind the camera."""
    depth = DepthMap(np.float32([[1.0, 2.0, 2.02, 4.0]]))
    fitted = fitted_map(depth, [Point(1, 0, 2.0), Point(2, 0, 2.6)])
    assert fitted.values == pytest.approx(depth.values * 1.13, rel=0.05)
    same = fitted_map(depth, [Point(1, 0, 2.0), Point(1, 0, 3.0)])
    assert same.values[0, 3] / same.values[0, 0] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize(
    ("fit", "law"), [(DepthFit.GLOBAL, (1.15, 1.287)), (DepthFit.LOCAL, (7.9, 1.594))]
)
def test_the_expected_error_is_by_the_distance_to_the_nearest_point(
    fit: DepthFit, law: tuple[float, float]
) -> None:
    truth_m, error = RANDOM.uniform(1, 9, (24, 32)), RANDOM.uniform(0.05, 0.2, (24, 32))
    places = [(3, 4), (3, 20), (9, 9), (15, 2), (12, 18), (8, 14)]
    points = KnownDepth.of([Point(x, y, truth_m[y, x]) for x, y in places])
    depth = DepthMap(np.float32(truth_m * 1.1), error=np.float32(error))
    result, _ = fit_known_depth(depth, replace(points, fit=fit))
    factor, power = law
    expected = np.zeros_like(error)
    for y, x in np.ndindex(error.shape):
        distance = min(math.dist((x, y), place) for place in places) / 32
        rest = (7 / 6) ** 0.933 if fit is DepthFit.GLOBAL else (distance + 0.01) ** 0.757
        expected[y, x] = factor * error[y, x] ** power * rest
    np.testing.assert_allclose(result.error, expected, rtol=0.03)  # the distance is to 2 %


def test_fitted_depth_behind_the_camera_is_invalid() -> None:
    near_and_far = [Point(2, 0, 1.0), Point(3, 0, 4.0)]  # depth = 3 × value − 5
    depth = DepthMap(np.float32([[0.0, 1.6, 2.0, 3.0]]), DepthKind.RELATIVE)
    fitted = fitted_map(depth, near_and_far)
    np.testing.assert_allclose(fitted.values, [[np.nan, np.nan, 1, 4]], rtol=1e-5)
    inverse = DepthMap(np.float32([[0.0, 0.49, 1.0, 0.625]]), DepthKind.INVERSE)
    fitted = fitted_map(inverse, near_and_far)  # 1 / depth = 2 × value − 1
    np.testing.assert_allclose(fitted.values, [[np.nan, np.nan, 1, 4]], rtol=1e-5)
    nothing = DepthMap(np.float32([[0.0, 2.0, 4.0]]), DepthKind.RELATIVE)
    for depth in (nothing, DepthMap(nothing.values)):  # one point fits the scale
        fitted = fitted_map(depth, [Point(1, 0, 3.0)])
        np.testing.assert_allclose(fitted.values, [[np.nan, 3, 6]], rtol=1e-6)


def behind(kind: DepthKind) -> tuple[DepthMap, list[Point]]:
    """Three points, below 0 at one of which is the best line through them."""
    depths_m = enumerate((0.01, 0.02, 3.0))
    points = [Point(x, 0, 1 / m if kind is DepthKind.INVERSE else m) for x, m in depths_m]
    return DepthMap(np.float32([[0.0, 1.0, 2.0]]), kind), points


HOLEY = DepthMap(np.float32([[1.0, 9.0, np.nan, 0.0]]))


@pytest.mark.parametrize(
    ("depth", "points"),
    [
        *((HOLEY, [Point(*place, 1)]) for place in ((4, 0), (0, 1))),  # outside
        *((HOLEY, [Point(x, 0, 1)]) for x in (2, 3)),  # without depth in the map
        *((HOLEY, [Point(0, 0, depth_m)]) for depth_m in (0.0, math.inf)),
        (HOLEY, []),
        (HOLEY, [Point(0, 0, 9), Point(1, 0, 1)]),  # of the other order
        *(behind(kind) for kind in (DepthKind.RELATIVE, DepthKind.INVERSE)),
    ],
)
def test_impossible_anchors_are_refused(depth: DepthMap, points: list[Point]) -> None:
    with pytest.raises(UsageError):
        fitted_map(depth, points)


def scene(kind: DepthKind) -> tuple[DepthMap, np.ndarray]:
    """A map of a kind, and its metres."""
    random = np.random.default_rng(5)
    truth_m = random.uniform(1, 9, (60, 80))
    values = 1 / truth_m if kind is DepthKind.INVERSE else truth_m
    return DepthMap(((values - 0.05) / 1.7).astype(np.float32), kind), truth_m


@pytest.mark.parametrize("kind", list(DepthKind))
def test_many_points_are_fitted_in_spite_of_wrong_ones(kind: DepthKind) -> None:
    """A third is of a surface behind: least squares are far off."""
    depth, truth_m = scene(kind)
    random = np.random.default_rng(6)
    sensed_m = truth_m * random.normal(1, 0.01, truth_m.shape)
    is_wrong = random.random(truth_m.shape) < 0.33
    sensed_m[is_wrong] = random.uniform(9, 14, is_wrong.sum())
    sensed_m[random.random(truth_m.shape) < 0.5] = 0
    points = KnownDepth.of_map(sensed_m)
    metric = fitted_map(depth, points)
    assert metric.kind is DepthKind.METRIC
    assert np.mean(np.abs(metric.values / truth_m - 1) < 0.02) > 0.99
    assert metric.provenance.anchors == ()
    fit = metric.provenance.anchor_fit
    assert fit.given == len(points) == np.count_nonzero(sensed_m)
    assert 0.6 * fit.given < fit.used < 0.75 * fit.given
    y, x = np.nonzero(sensed_m)
    errors_m = np.abs(metric.values[y, x] - sensed_m[y, x])
    assert fit.residual_m == pytest.approx(np.median(errors_m))


@pytest.mark.parametrize("kind", list(DepthKind))
def test_of_five_points_a_wrong_one_has_no_effect(kind: DepthKind) -> None:
    depth, truth_m = scene(kind)
    points = [Point(x, 0, float(truth_m[0, x])) for x in range(5)]
    points[2] = points[2]._replace(depth_m=14.0)
    metric = fitted_map(depth, points)
    # Of metric maps, five points side by side say little about a shift.
    assert metric.values == pytest.approx(truth_m, rel=1e-2 if kind is DepthKind.METRIC else 1e-3)
    assert metric.provenance.anchor_fit.used == 4


def test_many_points_need_not_all_have_a_value_in_the_map_but_some_have_to_fit() -> None:
    depth, truth_m = scene(DepthKind.METRIC)
    depth.values[0, :40] = np.nan
    points = [Point(x, 0, float(truth_m[0, x])) for x in range(80)]
    metric = fitted_map(depth, points)
    assert metric.provenance.anchor_fit[:2] == (40, 80)
    for wrong in (points[:40], KnownDepth.of_map(10 - truth_m)):  # without depth, contradicting
        with pytest.raises(UsageError):
            fitted_map(depth, wrong)


def test_a_map_of_another_aspect_fails_its_image_alone() -> None:
    depth, truth_m = scene(DepthKind.METRIC)
    with pytest.raises(InputError):
        fitted(depth, KnownDepth.of_map(truth_m[:, 4:]))
    with pytest.raises(InputError):
        fitted(depth, KnownDepth.of_map(truth_m * 0))
    assert fitted(depth, None) == (depth, ())


def test_a_table_is_of_the_nearest_pixels() -> None:
    points = KnownDepth.of_table(np.array([[1.4, 2.6, 3.0], [0, 1, 2.5]]))
    assert points.listed() == (Point(1, 3, 3.0), Point(0, 1, 2.5))
    same = KnownDepth.of(points.listed())
    assert same.sha256() == points.sha256()
    assert same.sha256() != KnownDepth.of([Point(1, 3, 3.0), Point(0, 1, 2.6)]).sha256()


@pytest.mark.parametrize("side_px", [8, 40, 160])
def test_many_points_of_one_wall_do_not_flatten_the_image(side_px: int) -> None:
    """The wall of the map has waves of 3 %, which are no depth of the scene."""
    random = np.random.default_rng(0)
    true_m = np.tile(np.linspace(1, 6, 640, dtype=np.float32), (480, 1))
    true_m[100:260, 200:360] = 4
    waves = np.sin(np.arange(640) / 9) * 0.03 + np.sin(np.arange(480) / 7)[:, None] * 0.03
    depth = DepthMap((true_m / 1.3 * (1 + waves)).astype(np.float32))
    y, x = (random.integers(start, start + side_px, 2000) for start in (100, 200))
    elsewhere_y, elsewhere_x = random.integers(0, (480, 640), (12, 2)).T
    for count in (10, 100, 2000):
        for others in (0, 3, 12):
            seen_m = 4 * random.normal(1, 0.01, count)
            others_y, others_x = elsewhere_y[:others], elsewhere_x[:others]
            every_x, every_y = np.append(x[:count], others_x), np.append(y[:count], others_y)
            every_m = np.append(seen_m, true_m[others_y, others_x])
            fit = fitted_map(depth, KnownDepth(every_x, every_y, every_m))
            assert fit.values[:, :20].mean() == pytest.approx(1.08, abs=0.45)
            assert fit.values[:, -20:].mean() == pytest.approx(5.92, abs=0.45)


@pytest.mark.parametrize("count", [5, 8, 11, 12])
def test_points_spread_over_the_image_show_a_shift(count: int) -> None:
    map_m = np.random.default_rng(2).uniform(1, 9, (48, 64)).astype(np.float32)
    x, y = np.array([(7 + 10 * (i % 6), 6 + 12 * (i // 6 * 2)) for i in range(count)]).T
    truth_m = map_m * 1.2 + 0.5
    fit = fitted_map(DepthMap(map_m), KnownDepth(x, y, truth_m[y, x].astype(np.float64)))
    assert fit.values == pytest.approx(truth_m, rel=1e-4)


HEIGHT, WIDTH = 48, 64
Y, X = np.mgrid[:HEIGHT, :WIDTH]


def scene_m() -> np.ndarray:
    """A wall at 4 m, and a box at 2 m before it."""
    return np.where((X > 20) & (X < 44) & (Y > 12), 2.0, 4.0) + 0.01 * Y


def mapped_m() -> np.ndarray:
    """The scene as a network sees it: the box too far, the wall too near on the right."""
    error = np.where(scene_m() < 3, 0.12, -0.3 * X / WIDTH)
    return (scene_m() * np.exp(error)).astype(np.float32)


def points(count: int, *, noise: float = 0, wrong: float = 0, seed: int = 1) -> KnownDepth:
    """Points of the scene at random."""
    random = np.random.default_rng(seed)
    x, y = random.integers(0, WIDTH, count), random.integers(0, HEIGHT, count)
    depth_m = scene_m()[y, x] * random.normal(1, noise, count)
    is_wrong = random.random(count) < wrong
    depth_m[is_wrong] *= random.uniform(1.5, 3, is_wrong.sum())
    return KnownDepth.of_table(np.stack([x, y, depth_m], axis=1))


def _both(depth: DepthMap, anchors: KnownDepth) -> tuple[DepthMap, DepthMap]:
    """The map as it is fitted, and as it follows the points."""
    return fitted_map(depth, replace(anchors, fit=DepthFit.GLOBAL)), fitted_map(depth, anchors)


def abs_rel(depth: DepthMap) -> float:
    return float(np.abs(depth.values / scene_m() - 1).mean())


@pytest.mark.parametrize("kind", DepthKind)
def test_map_follows_points_on_both_sides_of_an_edge(kind: DepthKind) -> None:
    values = 0.5 / mapped_m() if kind is DepthKind.INVERSE else mapped_m() / 3
    depth = DepthMap(values, kind)
    alone, followed = _both(depth, points(300))
    assert abs_rel(alone) > 0.04
    assert abs_rel(followed) < 0.015
    step = followed.values[30, 21] - followed.values[30, 20]
    assert step == pytest.approx(scene_m()[30, 21] - scene_m()[30, 20], rel=0.1)


def test_noise_of_points_is_not_copied() -> None:
    depth = DepthMap(mapped_m(), DepthKind.METRIC)
    anchors = points(600, noise=0.05)
    followed = fitted_map(depth, anchors)
    at_points = followed.values[anchors.y, anchors.x] / scene_m()[anchors.y, anchors.x] - 1
    assert np.abs(at_points).mean() < 0.7 * 0.04  # mean of the noise


def test_depth_far_from_all_points_is_that_of_the_fit_and_missing_depth_stays_so() -> None:
    depth = DepthMap(mapped_m(), DepthKind.METRIC)
    depth.values[40:44, 5:9] = np.nan
    anchors = points(2000)
    corner = (anchors.x < 12) & (anchors.y < 12)
    some = KnownDepth(anchors.x[corner], anchors.y[corner], anchors.depth_m[corner])
    alone, followed = _both(depth, some)
    changed = np.abs(np.log(followed.values / alone.values))
    assert changed[:, 60:].max() < 0.02
    np.testing.assert_array_equal(np.isnan(followed.values), np.isnan(depth.values))


def test_fewer_than_five_points_are_fitted_alone() -> None:
    depth = DepthMap(mapped_m(), DepthKind.METRIC)
    alone, followed = _both(depth, points(4))
    np.testing.assert_array_equal(alone.values, followed.values)


def test_a_level_sums_points_as_a_plain_loop_does() -> None:
    """Each point is spread linearly to eight nodes, weighted by distance, and read likewise."""
    random = np.random.default_rng(3)
    at = random.uniform([[0.1], [0.1], [0.1]], [[0.9], [0.9], [1.1]], (3, 12))
    level = local_correction._Level(0.1, at, 0.75, 0.0, 1.2)
    rows, columns, _ = level.nodes
    scale = np.array([rows, columns, 1 / level.depth_step])
    places = at * scale[:, None] - np.array([[0.5], [0.5], [0]])
    for i, j in itertools.product(range(12), repeat=2):
        plain = (1.5 / (1 + 0.5 * math.exp(-0.5))) ** 3
        for mine, other in zip(places[:, i], places[:, j], strict=True):
            plain *= sum(
                (1 - abs(mine - m)) * (1 - abs(other - n)) * math.exp(-0.5 * (m - n) ** 2)
                for m in (math.floor(mine), math.floor(mine) + 1)
                for n in (math.floor(other), math.floor(other) + 1)
            )
        alone = level.spread((np.arange(12) == j).astype(float))
        assert level.read(alone)[i] == pytest.approx(plain, abs=1e-5)


def test_points_outside_are_left_out_and_counted() -> None:
    x, y = np.array([3, 10, 64, 30]), np.array([4, 10, 20, 40])
    inside = KnownDepth(x, y, np.full(4, 2.0)).within(WIDTH, HEIGHT)
    assert inside.x.tolist() == [3, 10, 30]
    assert "1 of 4" in inside.warnings[0]
    depth, warnings = fitted(
        DepthMap(mapped_m(), DepthKind.METRIC), KnownDepth(x, y, np.full(4, 2.0))
    )
    assert depth.provenance.anchor_fit.given == 4
    assert warnings == inside.warnings
    with pytest.raises(UsageError, match="3 of 4"):
        KnownDepth(x + 60, y, np.full(4, 2.0)).within(WIDTH, HEIGHT)


def test_known_depth_of_another_size_is_scaled() -> None:
    sparse = np.zeros((24, 32), np.float32)
    sparse[0, 0], sparse[23, 31] = 2.0, 3.0
    scaled = KnownDepth.of_map(sparse).within(WIDTH, HEIGHT)
    assert scaled.x.tolist() == [1, 63]
    assert scaled.y.tolist() == [1, 47]
    with pytest.raises(UsageError, match="aspect"):
        KnownDepth.of_map(sparse).within(WIDTH, WIDTH)
