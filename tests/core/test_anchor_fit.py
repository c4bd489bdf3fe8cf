"""Fitting depth to few and to many points, against maps whose depth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from depthcli.core.anchor_fit import fit_anchors, fitted
from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Anchor as Point
from depthcli.core.types import AnchorFit, DepthKind, DepthMap
from depthcli.errors import InputError, UsageError

RANDOM = np.random.default_rng(3)


@pytest.mark.parametrize("kind", list(DepthKind))
def test_anchors_recover_scale_and_shift(kind: DepthKind) -> None:
    truth_m = RANDOM.uniform(1, 9, (8, 10))
    seen = 1 / truth_m if kind is DepthKind.INVERSE else truth_m
    depth = DepthMap(((seen - 0.05) / 1.7).astype(np.float32), kind)
    points = [Point(x, y, float(truth_m[y, x])) for x, y in [(0, 0), (9, 7), (4, 2)]]
    fitted = fit_anchors(depth, points)
    assert fitted.kind is DepthKind.METRIC
    assert fitted.values == pytest.approx(truth_m, rel=1e-3)


def test_one_anchor_fits_the_scale() -> None:
    depth = DepthMap(np.array([[1.0, 2.0]], np.float32))
    assert fit_anchors(depth, [Point(1, 0, 3.0)]).values == pytest.approx(np.array([[1.5, 3.0]]))


def test_two_anchors_one_unit_apart_fit_scale_and_shift() -> None:
    depth = DepthMap(np.float32([[1, 2, 3]]), DepthKind.RELATIVE)
    fitted = fit_anchors(depth, [Point(0, 0, 3.0), Point(1, 0, 7.0)])
    assert fitted.values == pytest.approx(np.array([[3, 7, 11]]))


def test_what_the_fit_puts_behind_the_camera_has_no_depth() -> None:
    near_and_far = [Point(2, 0, 1.0), Point(3, 0, 4.0)]  # depth = 3 × value − 5
    depth = DepthMap(np.float32([[0.0, 1.6, 2.0, 3.0]]), DepthKind.RELATIVE)
    fitted = fit_anchors(depth, near_and_far)
    np.testing.assert_allclose(fitted.values, [[np.nan, np.nan, 1, 4]], rtol=1e-5)
    inverse = DepthMap(np.float32([[0.0, 0.49, 1.0, 0.625]]), DepthKind.INVERSE)
    fitted = fit_anchors(inverse, near_and_far)  # 1 / depth = 2 × value − 1
    np.testing.assert_allclose(fitted.values, [[np.nan, np.nan, 1, 4]], rtol=1e-5)
    nothing = DepthMap(np.float32([[0.0, 2.0]]), DepthKind.RELATIVE)
    np.testing.assert_allclose(fit_anchors(nothing, [Point(1, 0, 3.0)]).values, [[np.nan, 3]])


@pytest.mark.parametrize("kind", list(DepthKind))
def test_an_anchor_behind_the_camera_is_refused(kind: DepthKind) -> None:
    """The best line through these three is below 0 at one of them."""
    values = np.float32([[0.0, 1.0, 2.0]])
    wanted = (0.01, 0.02, 3.0)
    points = [
        Point(x, 0, 1 / value if kind is DepthKind.INVERSE else value)
        for x, value in enumerate(wanted)
    ]
    with pytest.raises(UsageError, match="ahead of the camera"):
        fit_anchors(DepthMap(values, kind), points)


@pytest.mark.parametrize("value", [0.0, -2.0])
@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_one_anchor_never_turns_near_into_far(value: float, kind: DepthKind) -> None:
    depth = DepthMap(np.float32([[value, 1.0]]), kind)
    with pytest.raises(UsageError, match="two anchors"):
        fit_anchors(depth, [Point(0, 0, 3.0)])


@pytest.mark.parametrize(
    ("points", "why"),
    [
        ([Point(3, 0, 1)], "outside the picture of 3×1"),
        ([Point(0, 1, 1)], "outside the picture of 3×1"),
        ([Point(2, 0, 1)], "no depth"),
        ([Point(0, 0, 2), Point(1, 0, 1)], "contradict"),
        ([Point(0, 0, 1), Point(0, 0, 2)], "all anchors have the same depth"),
        ([Point(0, 0, 0.0)], "give one above 0"),
        ([Point(0, 0, math.inf)], "give one above 0"),
        ([], "there are no anchors"),
    ],
)
def test_impossible_anchors_are_refused(points: list[Point], why: str) -> None:
    depth = DepthMap(np.array([[1.0, 2.0, np.nan]], np.float32))
    with pytest.raises(UsageError, match=why):
        fit_anchors(depth, points)


def scene(kind: DepthKind) -> tuple[DepthMap, np.ndarray]:
    """A map of a kind, and its metres."""
    random = np.random.default_rng(5)
    truth_m = random.uniform(1, 9, (60, 80))
    seen = 1 / truth_m if kind is DepthKind.INVERSE else truth_m
    return DepthMap(((seen - 0.05) / 1.7).astype(np.float32), kind), truth_m


@pytest.mark.parametrize("kind", list(DepthKind))
def test_many_points_are_fitted_in_spite_of_wrong_ones(kind: DepthKind) -> None:
    """A third is of a surface behind: least squares are far off."""
    depth, truth_m = scene(kind)
    random = np.random.default_rng(6)
    sensed_m = truth_m * random.normal(1, 0.01, truth_m.shape)
    is_wrong = random.random(truth_m.shape) < 0.33
    sensed_m[is_wrong] = random.uniform(9, 14, is_wrong.sum())
    sensed_m[random.random(truth_m.shape) < 0.5] = 0
    points = AnchorPoints.of_map(sensed_m)
    found = fit_anchors(depth, points)
    assert found.kind is DepthKind.METRIC
    assert found.values == pytest.approx(truth_m, rel=0.02)
    source = found.provenance
    assert source is not None
    assert source.anchors == ()
    fit = source.anchor_fit
    assert fit is not None
    assert fit.given == len(points) == np.count_nonzero(sensed_m)
    assert 0.6 * fit.given < fit.used < 0.75 * fit.given
    y, x = np.nonzero(sensed_m)
    errors_m = np.abs(found.values[y, x] - sensed_m[y, x])
    assert fit.residual_m == pytest.approx(np.median(errors_m))


def test_exact_points_are_all_used_but_the_wrong_ones() -> None:
    depth, truth_m = scene(DepthKind.RELATIVE)
    points = [Point(x, 3, float(truth_m[3, x])) for x in range(30)]
    points[4] = points[4]._replace(depth_m=40.0)
    found = fit_anchors(depth, points)
    assert found.values == pytest.approx(truth_m, rel=1e-4)
    assert found.provenance is not None
    assert found.provenance.anchor_fit == AnchorFit(29, 30, pytest.approx(0, abs=1e-4))
    assert found.provenance.anchors == tuple(points)


def test_nine_points_are_fitted_by_least_squares() -> None:
    depth, truth_m = scene(DepthKind.METRIC)
    points = [Point(x, 0, float(truth_m[0, x])) for x in range(9)]
    points[4] = points[4]._replace(depth_m=12.0)
    found = fit_anchors(depth, points)
    values = [float(depth.values[0, x]) for x in range(9)]
    scale, shift = np.polyfit(values, [point.depth_m for point in points], 1)
    assert found.values == pytest.approx(depth.values * scale + shift, rel=1e-4)
    assert found.provenance is not None
    assert found.provenance.anchor_fit is not None
    assert found.provenance.anchor_fit.used == 9


def test_many_points_are_thinned_evenly() -> None:
    random = np.random.default_rng(1)
    truth_m = random.uniform(1, 9, (400, 500))
    found = fit_anchors(DepthMap((truth_m / 2).astype(np.float32)), AnchorPoints.of_map(truth_m))
    assert found.values == pytest.approx(truth_m, rel=1e-5)
    assert found.provenance is not None
    assert found.provenance.anchor_fit is not None
    assert found.provenance.anchor_fit.used == truth_m.size


def test_many_points_need_not_all_have_a_value_in_the_map() -> None:
    depth, truth_m = scene(DepthKind.METRIC)
    depth.values[0, :40] = np.nan
    points = [Point(x, 0, float(truth_m[0, x])) for x in range(80)]
    found = fit_anchors(depth, points)
    assert found.provenance is not None
    assert found.provenance.anchor_fit is not None
    assert found.provenance.anchor_fit[:2] == (40, 80)
    with pytest.raises(UsageError, match="anchor 0,0 has no depth"):
        fit_anchors(depth, points[:40])


def test_many_contradicting_points_are_refused() -> None:
    depth, truth_m = scene(DepthKind.METRIC)
    with pytest.raises(UsageError, match="contradict"):
        fit_anchors(depth, AnchorPoints.of_map(10 - truth_m))


def test_a_map_of_another_size_fails_its_picture_alone() -> None:
    depth, truth_m = scene(DepthKind.METRIC)
    with pytest.raises(InputError, match="known depth is 79×60 pixels, but the picture is 80×60"):
        fitted(depth, AnchorPoints.of_map(truth_m[:, 1:]))
    with pytest.raises(InputError, match="there are no anchors"):
        fitted(depth, AnchorPoints.of_map(truth_m * 0))
    assert fitted(depth, ()) is depth


def test_a_table_is_of_the_nearest_pixels() -> None:
    points = AnchorPoints.of_table(np.array([[1.4, 2.6, 3.0], [0, 1, 2.5]]))
    assert points.listed() == (Point(1, 3, 3.0), Point(0, 1, 2.5))
    same = AnchorPoints.of(points.listed())
    assert same.sha256() == points.sha256()
    assert same.sha256() != AnchorPoints.of([Point(1, 3, 3.0), Point(0, 1, 2.6)]).sha256()
