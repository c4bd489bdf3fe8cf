import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.core.options import Alignment
from depthcli.core.types import DepthKind
from depthcli.metrics.alignment import SUITABLE, align, is_reversed

TRUTH = np.random.default_rng(2).uniform(0.5, 9.5, 300)
SCALES = st.floats(0.01, 100)
SHIFTS = st.floats(-50, 50)


@given(scale=SCALES)
def test_median_recovers_a_known_scale(scale: float) -> None:
    np.testing.assert_allclose(align(TRUTH * scale, TRUTH, Alignment.MEDIAN), TRUTH, rtol=1e-9)


@given(scale=SCALES, shift=SHIFTS)
def test_depth_recovers_a_known_scale_and_shift(scale: float, shift: float) -> None:
    predicted = TRUTH * scale + shift
    for kind in (DepthKind.METRIC, DepthKind.RELATIVE):
        aligned = align(predicted, TRUTH, Alignment.DEPTH, kind)
        np.testing.assert_allclose(aligned, TRUTH, rtol=1e-6)


@given(scale=SCALES | st.floats(-100, -0.01), shift=SHIFTS)
def test_disparity_recovers_a_known_scale_and_shift(scale: float, shift: float) -> None:
    predicted = scale / TRUTH + shift
    aligned = align(predicted, TRUTH, Alignment.DISPARITY, DepthKind.INVERSE)
    np.testing.assert_allclose(aligned, TRUTH, rtol=1e-6)


@given(scale=SCALES | st.floats(-100, -0.01), shift=SHIFTS)
def test_a_negative_scale_reverses_the_order(scale: float, shift: float) -> None:
    for alignment, kind, line in (
        (Alignment.DEPTH, DepthKind.RELATIVE, TRUTH),
        (Alignment.DISPARITY, DepthKind.INVERSE, 1 / TRUTH),
    ):
        assert is_reversed(scale * line + shift, TRUTH, alignment, kind) is (scale < 0)
    assert is_reversed(TRUTH, TRUTH, Alignment.DISPARITY) is False
    assert is_reversed(1 / TRUTH, TRUTH, Alignment.DEPTH) is True


@pytest.mark.parametrize("alignment", list(Alignment))
def test_map_without_order_is_not_reversed(alignment: Alignment) -> None:
    for value in (2.5, np.nan):
        assert is_reversed(np.full(300, value), TRUTH, alignment) is False


def test_disparity_of_metres_is_fitted_in_their_reciprocal() -> None:
    predicted = 1 / (0.7 / TRUTH + 0.2)
    np.testing.assert_allclose(align(predicted, TRUTH, Alignment.DISPARITY), TRUTH, rtol=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
def test_fit_is_the_least_squares_solution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    predicted, truth = rng.normal(3, 2, 40), rng.uniform(0.5, 9.5, 40)
    design = np.stack([predicted, np.ones(40)], axis=1)
    solution = np.linalg.lstsq(design, truth, rcond=None)[0]
    aligned = align(predicted, truth, Alignment.DEPTH)
    np.testing.assert_allclose(aligned, design @ solution, rtol=1e-7, atol=1e-9)


def test_without_alignment_nothing_changes() -> None:
    predicted = np.array([1.0, np.nan, np.inf, -2.0])
    np.testing.assert_array_equal(align(predicted, np.ones(4), Alignment.NONE), predicted)


@pytest.mark.parametrize("value", [2.5, 0.0, 0.1])
def test_constant_prediction_becomes_the_mean(value: float) -> None:
    aligned = align(np.full(300, value), TRUTH, Alignment.DEPTH)
    np.testing.assert_allclose(aligned, TRUTH.mean(), rtol=1e-9)


@pytest.mark.parametrize("alignment", [Alignment.MEDIAN, Alignment.DEPTH, Alignment.DISPARITY])
def test_unusable_pixels_stay_out_of_the_fit(alignment: Alignment) -> None:
    predicted = TRUTH * 2
    predicted[::10] = np.nan
    aligned = align(predicted, TRUTH, alignment)
    known = np.ones(300, bool)
    known[::10] = False
    np.testing.assert_allclose(aligned[known], TRUTH[known], rtol=1e-9)
    assert np.isnan(aligned[~known]).all()


def test_median_looks_at_positive_finite_pixels_only() -> None:
    predicted = np.array([-100.0, np.inf, 1.0, 2.0, 3.0])
    aligned = align(predicted, np.array([9.0, 9.0, 2.0, 4.0, 6.0]), Alignment.MEDIAN)
    np.testing.assert_array_equal(aligned[2:], [2.0, 4.0, 6.0])


def test_disparity_beyond_infinity_is_infinitely_far() -> None:
    truth = np.array([0.1, 0.1, 9.0, 9.0])
    predicted = np.array([1.0, 1.0, 0.05, -0.1])
    aligned = align(predicted, truth, Alignment.DISPARITY, DepthKind.INVERSE)
    assert np.isposinf(aligned[3])
    assert np.isfinite(aligned[:3]).all()


def test_infinite_metres_have_no_disparity() -> None:
    truth = np.array([1.0, 2.0, 4.0, 8.0])
    aligned = align(np.array([1.0, 2.0, 4.0, np.inf]), truth, Alignment.DISPARITY)
    assert np.isfinite(aligned).all()
    assert aligned[3] > aligned[2]


def test_metres_that_are_not_positive_have_no_disparity() -> None:
    predicted = np.array([1.0, 2.0, 4.0, 0.0, -3.0])
    truth = np.array([1.0, 2.0, 4.0, 5.0, 6.0])
    aligned = align(predicted, truth, Alignment.DISPARITY)
    np.testing.assert_allclose(aligned[:3], truth[:3])
    assert np.isnan(aligned[3:]).all()


@pytest.mark.parametrize("alignment", Alignment)
def test_prediction_without_usable_pixel_comes_back(alignment: Alignment) -> None:
    assert np.isnan(align(np.full(4, np.nan), np.ones(4), alignment)).all()


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_relative_depth_has_exactly_one_alignment(kind: DepthKind) -> None:
    for alignment in set(Alignment) - set(SUITABLE[kind]):
        with pytest.raises(ValueError, match=f"{kind} depth cannot be aligned by {alignment}"):
            align(TRUTH, TRUTH, alignment, kind)
