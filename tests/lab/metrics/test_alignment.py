"""Alignment, boundaries and accumulation of metrics."""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from helpers import plain_boundary as plain
from hypothesis import given, strategies as st

from depthcli.core.types import DepthKind
from depthcli.lab.metrics.alignment import SUITABLE, align
from depthcli.lab.metrics.boundary import (
    BoundaryScores,
    _edges,
    _log,
    boundary_scores,
    mean_boundary_scores,
)
from depthcli.lab.metrics.depth import DepthPixels, PixelSums, Scores, mean_scores
from depthcli.lab.options import Alignment, Averaging

TRUTH = np.random.default_rng(2).uniform(0.5, 9.5, 300)
SCALES = st.floats(0.01, 100)
SHIFTS = st.floats(-50, 50)


def fitted(*arguments: Any) -> Any:
    return align(*arguments)[0]


@given(scale=SCALES, shift=SHIFTS)
def test_depth_recovers_a_known_scale_and_shift(scale: float, shift: float) -> None:
    predicted = TRUTH * scale + shift
    for kind in (DepthKind.METRIC, DepthKind.RELATIVE):
        aligned = fitted(predicted, TRUTH, Alignment.DEPTH, kind)
        np.testing.assert_allclose(aligned, TRUTH, rtol=1e-6)


@given(scale=SCALES | st.floats(-100, -0.01), shift=SHIFTS)
def test_disparity_recovers_a_known_scale_and_shift(scale: float, shift: float) -> None:
    predicted = scale / TRUTH + shift
    aligned = fitted(predicted, TRUTH, Alignment.DISPARITY, DepthKind.INVERSE)
    np.testing.assert_allclose(aligned, TRUTH, rtol=1e-6)


@given(scale=SCALES | st.floats(-100, -0.01), shift=SHIFTS)
def test_a_negative_scale_reverses_the_order(scale: float, shift: float) -> None:
    for alignment, kind, line in (
        (Alignment.DEPTH, DepthKind.RELATIVE, TRUTH),
        (Alignment.DISPARITY, DepthKind.INVERSE, 1 / TRUTH),
    ):
        assert align(scale * line + shift, TRUTH, alignment, kind)[1] is (scale < 0)
    assert align(TRUTH, TRUTH, Alignment.DISPARITY)[1] is False
    assert align(1 / TRUTH, TRUTH, Alignment.DEPTH)[1] is True


@pytest.mark.parametrize("alignment", list(Alignment))
def test_map_without_order_is_not_reversed(alignment: Alignment) -> None:
    for value in (2.5, np.nan):
        assert align(np.full(300, value), TRUTH, alignment)[1] is False


def test_disparity_of_metres_is_fitted_in_their_reciprocal() -> None:
    predicted = 1 / (0.7 / TRUTH + 0.2)
    np.testing.assert_allclose(fitted(predicted, TRUTH, Alignment.DISPARITY), TRUTH, rtol=1e-9)


def test_without_alignment_nothing_changes() -> None:
    predicted = np.array([1.0, np.nan, np.inf, -2.0])
    np.testing.assert_array_equal(fitted(predicted, np.ones(4), Alignment.NONE), predicted)


@pytest.mark.parametrize("value", [2.5, 0.0, 0.1])
def test_constant_prediction_becomes_the_mean(value: float) -> None:
    aligned = fitted(np.full(300, value), TRUTH, Alignment.DEPTH)
    np.testing.assert_allclose(aligned, TRUTH.mean(), rtol=1e-9)


@pytest.mark.parametrize("alignment", [Alignment.MEDIAN, Alignment.DEPTH, Alignment.DISPARITY])
def test_unusable_pixels_stay_out_of_the_fit(alignment: Alignment) -> None:
    predicted = TRUTH * 2
    predicted[::10] = np.nan
    aligned = fitted(predicted, TRUTH, alignment)
    valid = np.ones(300, bool)
    valid[::10] = False
    np.testing.assert_allclose(aligned[valid], TRUTH[valid], rtol=1e-9)
    assert np.isnan(aligned[~valid]).all()


def test_median_looks_at_positive_finite_pixels_only() -> None:
    predicted = np.array([-100.0, np.inf, 1.0, 2.0, 3.0])
    aligned = fitted(predicted, np.array([9.0, 9.0, 2.0, 4.0, 6.0]), Alignment.MEDIAN)
    np.testing.assert_array_equal(aligned[2:], [2.0, 4.0, 6.0])


def test_disparity_beyond_infinity_is_infinitely_far() -> None:
    truth = np.array([0.1, 0.1, 9.0, 9.0])
    predicted = np.array([1.0, 1.0, 0.05, -0.1])
    aligned = fitted(predicted, truth, Alignment.DISPARITY, DepthKind.INVERSE)
    assert np.isposinf(aligned[3])
    assert np.isfinite(aligned[:3]).all()


def test_infinite_metres_have_no_disparity() -> None:
    truth = np.array([1.0, 2.0, 4.0, 8.0])
    aligned = fitted(np.array([1.0, 2.0, 4.0, np.inf]), truth, Alignment.DISPARITY)
    assert np.isfinite(aligned).all()
    assert aligned[3] > aligned[2]


def test_metres_that_are_not_positive_have_no_disparity() -> None:
    predicted = np.array([1.0, 2.0, 4.0, 0.0, -3.0])
    truth = np.array([1.0, 2.0, 4.0, 5.0, 6.0])
    aligned = fitted(predicted, truth, Alignment.DISPARITY)
    np.testing.assert_allclose(aligned[:3], truth[:3])
    assert np.isnan(aligned[3:]).all()


@pytest.mark.parametrize("alignment", Alignment)
def test_prediction_without_usable_pixel_comes_back(alignment: Alignment) -> None:
    assert np.isnan(fitted(np.full(4, np.nan), np.ones(4), alignment)).all()


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_relative_depth_has_exactly_one_alignment(kind: DepthKind) -> None:
    for alignment in set(Alignment) - set(SUITABLE[kind]):
        with pytest.raises(ValueError, match=f"{kind} depth cannot be aligned by {alignment}"):
            fitted(TRUTH, TRUTH, alignment, kind)


def _mean(averaging: Averaging, images: list[DepthPixels]) -> Scores:
    return mean_scores(map(PixelSums.of, images), averaging)


def test_image_without_valid_pixel_is_left_out() -> None:
    pixels = DepthPixels.of(np.array([2.0]), np.array([3.0]))
    nothing = DepthPixels.of(np.array([0.0]), np.array([3.0]))
    assert math.isnan(PixelSums.of(nothing).scores()["abs_rel"])
    some = PixelSums.of(pixels)
    assert some + PixelSums.of(nothing) == some  # a range of distances that an image lacks
    assert _mean(Averaging.IMAGE, [pixels, nothing])["abs_rel"] == 0.5


@pytest.mark.parametrize("averaging", Averaging)
def test_nothing_seen_is_not_a_number(averaging: Averaging) -> None:
    assert all(math.isnan(value) for value in _mean(averaging, []).values())


def _scene(seed: int, height: int = 22, width: int = 26) -> npt.NDArray[np.float64]:
    """A slope with boxes before it."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[0:height, 0:width]
    depth_m = 3 + 0.02 * rows + 0.03 * columns
    for _ in range(3):
        top, left = rng.integers(0, height - 4), rng.integers(0, width - 4)
        depth_m[top : top + rng.integers(4, 12), left : left + rng.integers(4, 12)] *= rng.uniform(
            0.5, 0.9
        )
    return depth_m


def _everywhere(depth_m: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    return np.ones(depth_m.shape, np.bool_)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("holes", [False, True])
def test_scores_equal_the_plain_loops(seed: int, holes: bool) -> None:
    truth, predicted = _scene(seed), cv2.blur(_scene(seed), (2, 2), anchor=(seed % 2, 0))
    valid = _everywhere(truth)
    if holes:
        valid[2:4, 3:5] = False
        truth[~valid], predicted[~valid] = 1e-9, math.nan
    maps = truth, predicted
    edges = [plain.edges(depth_m, valid) for depth_m in maps]
    for depth_m, expected in zip(maps, edges, strict=True):
        np.testing.assert_array_equal(_edges(_log(depth_m, valid), valid), expected)
        assert np.any(expected)
    scores = boundary_scores(maps[0], maps[1], valid)
    accuracy, completeness = plain.distances(*edges)
    assert (scores.dbe_acc, scores.dbe_comp) == pytest.approx((accuracy, completeness), rel=1e-12)
    f1 = plain.edge_f1(*maps, valid)
    assert scores.edge_f1 == pytest.approx(f1, rel=1e-9)
    assert 0 < scores.edge_f1 < 1


def _step(column: int, near_m: float = 2.0, far_m: float = 3.0) -> npt.NDArray[np.float64]:
    depth_m = np.full((24, 40), near_m)
    depth_m[:, column:] = far_m
    return depth_m


@pytest.mark.parametrize("off", [1, 3, 9])
def test_an_edge_beside_the_true_one_is_off_by_so_many_pixels(off: int) -> None:
    truth, predicted = _step(20), _step(20 + off)
    scores = boundary_scores(truth, predicted, _everywhere(truth))
    assert (scores.dbe_acc, scores.dbe_comp) == pytest.approx((off, off))
    assert scores.edge_f1 == 0


def test_an_edge_exactly_ten_pixels_off_belongs_to_no_true_one() -> None:
    truth, predicted = _step(20), _step(23)
    predicted[:, 30:] = 4.5
    scores = boundary_scores(truth, predicted, _everywhere(truth))
    assert scores.dbe_acc == pytest.approx(3)
    assert scores.dbe_comp == pytest.approx((3 + 10 + 3) / 3)


@pytest.mark.parametrize("predicted", [np.full((24, 40), 2.0), _step(35)])
def test_no_edge_within_ten_pixels_is_ten(predicted: npt.NDArray[np.float64]) -> None:
    truth = _step(20)
    scores = boundary_scores(truth, predicted, _everywhere(truth))
    assert scores == BoundaryScores(10.0, 10.0, 0.0)


def test_a_truth_without_edges_has_no_score() -> None:
    flat = np.full((24, 40), 2.0)
    scores = boundary_scores(flat, _step(20), _everywhere(flat))
    assert all(math.isnan(value) for value in scores)


def test_missing_edges_cost_completeness_alone() -> None:
    truth = _step(10)
    truth[:, 30:] = 4.5
    scores = boundary_scores(truth, _step(10), _everywhere(truth))
    assert scores.dbe_acc == 0
    assert scores.dbe_comp == pytest.approx(10 / 3)
    assert scores.edge_f1 == pytest.approx(
        1 / 6
    )  # recall 1/8, precision 1/4: one direction of four


def test_means_leave_out_images_without_a_score() -> None:
    images = [
        BoundaryScores(1.0, 4.0, 0.5),
        BoundaryScores(math.nan, math.nan, 0.1),
        BoundaryScores(3.0, 6.0, math.nan),
    ]
    assert mean_boundary_scores(images) == BoundaryScores(2.0, 5.0, 0.3)
