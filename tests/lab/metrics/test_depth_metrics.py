"""Every metric against a plain loop that shares no code with it."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from helpers import plain_evaluator as plain
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from depthcli.errors import UsageError
from depthcli.lab.metrics import depth as metrics
from depthcli.lab.metrics.depth import (
    METRICS,
    DepthPixels,
    PixelSums,
    add_metric,
    in_full,
    mean_scores,
)
from depthcli.lab.options import Averaging


@st.composite
def _images(draw: st.DrawFn) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    shape = draw(hnp.array_shapes(min_dims=2, max_dims=2, max_side=6))
    truth = draw(hnp.arrays(np.float64, shape, elements=st.floats(0, 12)))
    anything = st.floats(0, 12) | st.sampled_from([math.nan, math.inf, -math.inf, -1.0, 1e-9])
    return truth, draw(hnp.arrays(np.float64, shape, elements=anything))


def score(name: str, pixels: DepthPixels) -> float:
    return PixelSums.of(pixels).scores()[name]


def test_every_metric_has_a_plain_reference() -> None:
    assert list(METRICS) == list(plain.metrics((np.ones(1), np.ones(1))))


@given(images=_images())
def test_metrics_equal_the_plain_loop(
    images: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]],
) -> None:
    pairs = plain.compare(*images)
    scores = PixelSums.of(DepthPixels.of(*images)).scores()
    expected = plain.metrics(pairs) if pairs[0].size else dict.fromkeys(METRICS, math.nan)
    for name, value in scores.items():
        # A difference of squares loses half the digits when all logs are alike.
        absolute = 1e-4 if name == "silog" else 1e-9
        assert value == pytest.approx(expected[name], rel=1e-6, abs=absolute, nan_ok=True), name


def test_metrics_of_depth_completion_equal_the_plain_loop_beside_one_s_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In any order with a metric of whole images."""
    pixels = DepthPixels.of(*np.random.default_rng(4).uniform(0.5, 9.5, (2, 2000)))
    pairs = pixels.truth_m, pixels.predicted_m
    monkeypatch.setattr("depthcli.lab.metrics.depth.METRICS", {})
    add_metric("worst", lambda g, p: float(np.max(p - g)))
    metrics.METRICS.update(metrics.OPTIONAL)
    scores = PixelSums.of(pixels).scores()
    assert scores.pop("worst") == pytest.approx((pairs[1] - pairs[0]).max())
    assert scores == pytest.approx(plain.optional_metrics(pairs))


def test_thresholds_are_strict() -> None:
    pixels = DepthPixels.of(np.array([4.0]), np.array([5.0]))
    assert score("d1", pixels) == 0.0
    assert score("d2", pixels) == 1.0
    assert score("d1", DepthPixels.of(np.array([5.0]), np.array([4.0]))) == 0.0


def test_a_metric_of_ones_own_gets_all_pixels_of_an_image() -> None:
    """Larger than a part; of several images pooled, it is weighted by their pixels."""
    random, before = np.random.default_rng(0), {"abs_rel": 0.5}
    pairs = [random.uniform(0.5, 9, (2, n)) for n in (200_000, 40_000)]
    add_metric("median_error", lambda g, p: float(np.median(abs(p - g))))
    try:
        sums = [PixelSums.of(DepthPixels.of(*pair)) for pair in pairs]
        each = [float(np.median(abs(p - g))) for g, p in pairs]
        assert [s.scores()["median_error"] for s in sums] == pytest.approx(each)
        assert mean_scores(sums)["median_error"] == pytest.approx(sum(each) / 2)
        pooled = mean_scores(sums, Averaging.POOLED)["median_error"]
        assert pooled == pytest.approx((5 * each[0] + each[1]) / 6)
        assert sums[0].scores()["abs_rel"] == pytest.approx(
            np.mean(abs(np.diff(pairs[0], axis=0)) / pairs[0][0])
        )
        empty = PixelSums.of(DepthPixels.of(np.zeros(3), np.ones(3)))
        assert (sums[1] + empty).scores() == sums[1].scores()
        assert math.isnan(in_full(before)["median_error"])  # as of the paper's rows
        with pytest.raises(UsageError):
            add_metric("rmse", np.dot)
    finally:
        METRICS.pop("median_error")


def test_bounds_of_the_truth_are_strict() -> None:
    truth = np.array([0.0, 1e-3, 1.1e-3, 9.99, 10.0, 11.0, np.nan, np.inf])
    assert DepthPixels.of(truth, np.ones(8)).truth_m.tolist() == [1.1e-3, 9.99]


def test_shapes_have_to_agree() -> None:
    with pytest.raises(ValueError, match=r"truth is \(3,\) but prediction is \(4,\)"):
        DepthPixels.of(np.ones(3), np.ones(4))


PUBLISHED = {
    "abs_rel": 0.24716666666666667,
    "sq_rel": 0.41570466666666667,
    "rmse": 1.643525468822028,
    "rms_log": 0.27928068299946596,
    "log10": 0.10552996866065992,
    "d1": 0.45,
    "d2": 0.9166666666666666,
    "d3": 1.0,
    "silog": 27.88497160978338,
}
"""Of the numbers below, by torch-uncertainty 0.13 and torchmetrics 1.9 in float64."""


def test_metrics_are_those_of_a_public_implementation() -> None:
    truth_m = np.array([0.5 + (k * 37 % 90) / 10 for k in range(60)])
    predicted_m = truth_m * np.array([0.6 + (k * 53 % 97) / 100 for k in range(60)])
    scores = PixelSums.of(DepthPixels.of(truth_m, predicted_m, max_m=100)).scores()
    assert dict(scores.items()) == pytest.approx(PUBLISHED, rel=1e-6)
