"""Depth that follows known points locally."""

import itertools
import math

import numpy as np
import pytest

from depthcli.core import local_correction
from depthcli.core.anchors import AnchorPoints, fit_anchors, fitted
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import UsageError

HEIGHT, WIDTH = 48, 64
Y, X = np.mgrid[:HEIGHT, :WIDTH]


def scene_m() -> np.ndarray:
    """A wall at 4 m, and a box at 2 m before it."""
    return np.where((X > 20) & (X < 44) & (Y > 12), 2.0, 4.0) + 0.01 * Y


def mapped_m() -> np.ndarray:
    """The scene as a network sees it: the box too far, the wall too near on the right."""
    error = np.where(scene_m() < 3, 0.12, -0.3 * X / WIDTH)
    return (scene_m() * np.exp(error)).astype(np.float32)


def points(count: int, *, noise: float = 0, wrong: float = 0, seed: int = 1) -> AnchorPoints:
    """Points of the scene at random."""
    random = np.random.default_rng(seed)
    x, y = random.integers(0, WIDTH, count), random.integers(0, HEIGHT, count)
    depth_m = scene_m()[y, x] * random.normal(1, noise, count)
    is_wrong = random.random(count) < wrong
    depth_m[is_wrong] *= random.uniform(1.5, 3, is_wrong.sum())
    return AnchorPoints.of_table(np.stack([x, y, depth_m], axis=1))


def abs_rel(depth: DepthMap) -> float:
    return float(np.abs(depth.values / scene_m() - 1).mean())


@pytest.mark.parametrize("kind", DepthKind)
def test_map_follows_points_on_both_sides_of_an_edge(kind: DepthKind) -> None:
    values = 0.5 / mapped_m() if kind is DepthKind.INVERSE else mapped_m() / 3
    depth = DepthMap(values, kind)
    alone, followed = (fit_anchors(depth, points(300), local=local) for local in (False, True))
    assert abs_rel(alone) > 0.04
    assert abs_rel(followed) < 0.015
    step = followed.values[30, 21] - followed.values[30, 20]
    assert step == pytest.approx(scene_m()[30, 21] - scene_m()[30, 20], rel=0.1)


def test_noise_of_points_is_not_copied() -> None:
    depth = DepthMap(mapped_m(), DepthKind.METRIC)
    seen = points(600, noise=0.05)
    followed = fit_anchors(depth, seen)
    at_points = followed.values[seen.y, seen.x] / scene_m()[seen.y, seen.x] - 1
    assert np.abs(at_points).mean() < 0.7 * 0.04  # mean of the noise


def test_wrong_points_have_no_effect() -> None:
    depth = DepthMap(mapped_m(), DepthKind.METRIC)
    followed = fit_anchors(depth, points(400, noise=0.02, wrong=0.25))
    assert abs_rel(followed) < 0.03
    fit = followed.provenance.anchor_fit if followed.provenance else None
    assert fit is not None
    assert 0.7 * 400 < fit.used < 0.8 * 400


def test_depth_far_from_all_points_is_that_of_the_fit() -> None:
    depth = DepthMap(mapped_m(), DepthKind.METRIC)
    seen = points(2000)
    corner = (seen.x < 12) & (seen.y < 12)
    some = AnchorPoints(seen.x[corner], seen.y[corner], seen.depth_m[corner])
    alone, followed = (fit_anchors(depth, some, local=local) for local in (False, True))
    changed = np.abs(np.log(followed.values / alone.values))
    assert changed[:, 60:].max() < 0.02
    assert np.isfinite(followed.values).all()


def test_fewer_than_five_points_are_fitted_alone() -> None:
    depth = DepthMap(mapped_m(), DepthKind.METRIC)
    alone, followed = (fit_anchors(depth, points(4), local=local) for local in (False, True))
    np.testing.assert_array_equal(alone.values, followed.values)


def test_pixels_without_depth_stay_so() -> None:
    values = mapped_m()
    values[5:9, 5:9] = np.nan
    followed = fit_anchors(DepthMap(values, DepthKind.METRIC), points(300))
    np.testing.assert_array_equal(np.isnan(followed.values), np.isnan(values))


def test_a_level_sums_points_as_a_plain_loop_does() -> None:
    """Each point is spread linearly to eight nodes, weighted by distance, and read likewise."""
    random = np.random.default_rng(3)
    at = random.uniform([[0.1], [0.1], [0.1]], [[1.1], [0.65], [0.9]], (3, 12))
    level = local_correction._Level(0.1, at, 0.75, 0.0, 1.2)
    _, rows, columns = level.nodes
    scale = np.array([1 / level.depth_step, rows / 0.75, columns])
    places = at * scale[:, None] - np.array([[0], [0.5], [0.5]])
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


def test_weight_of_a_point_at_itself_is_known() -> None:
    """Leaving a point out needs it; it depends on the place within the cell."""
    for place in ((0.31, 0.4, 0.52), (0.45, 0.33, 0.6), (0.5, 0.375, 0.5)):
        level = local_correction._Level(0.1, np.array([place]).T, 0.75, 0.0, 1.2)
        assert level.read(level.spread(np.ones(1))) == pytest.approx(level.own, rel=1e-9)


def test_points_outside_are_left_out_and_counted() -> None:
    x, y = np.array([3, 10, 64, 30]), np.array([4, 10, 20, 40])
    found = AnchorPoints(x, y, np.full(4, 2.0)).within(WIDTH, HEIGHT)
    assert found.x.tolist() == [3, 10, 30]
    assert "1 of 4" in found.warnings[0]
    depth, warnings = fitted(
        DepthMap(mapped_m(), DepthKind.METRIC), AnchorPoints(x, y, np.full(4, 2.0))
    )
    assert depth.provenance is not None
    assert depth.provenance.anchor_fit is not None
    assert depth.provenance.anchor_fit.given == 4
    assert warnings == found.warnings
    with pytest.raises(UsageError, match="3 of 4"):
        AnchorPoints(x + 60, y, np.full(4, 2.0)).within(WIDTH, HEIGHT)


def test_known_depth_of_another_size_is_scaled() -> None:
    sparse = np.zeros((24, 32), np.float32)
    sparse[0, 0], sparse[23, 31] = 2.0, 3.0
    found = AnchorPoints.of_map(sparse).within(WIDTH, HEIGHT)
    assert found.x.tolist() == [1, 63]
    assert found.y.tolist() == [1, 47]
    with pytest.raises(UsageError, match="aspect"):
        AnchorPoints.of_map(sparse).within(WIDTH, WIDTH)
