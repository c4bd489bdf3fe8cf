"""Depth that follows known points locally."""

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
    """One scale against the sum over all points, by the distance of their places."""
    random = np.random.default_rng(3)
    at = random.uniform([[0.0], [0.0], [0.0]], [[1.2], [0.75], [1.0]], (3, 40))
    values = random.normal(size=40)
    level = local_correction._Level(0.2, at, 0.75, 0.0, 1.2)
    found = level.read(level.spread(values))
    depth_sd = max(0.1, 0.3 * math.sqrt(0.2 / 0.4))
    sd = np.array([depth_sd, 0.75 / 4, 0.2])
    inside = at.clip(0, [[np.inf], [0.75 - 0.75 / 8], [0.9]])
    inside[1:] = inside[1:].clip([[0.75 / 8], [0.1]])
    plain = [
        sum(
            value * math.exp(-0.5 * float((((inside[:, i] - inside[:, j]) / sd) ** 2).sum()))
            for j, value in enumerate(values)
        )
        for i in range(40)
    ]
    assert np.corrcoef(found, plain)[0, 1] > 0.98
    assert np.abs(found - plain).max() < 0.35 * np.abs(plain).max()


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
