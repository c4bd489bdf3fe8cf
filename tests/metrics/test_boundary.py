"""Depth boundaries against plain loops, and what the scores promise."""

import math

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from helpers import plain_boundary as plain

from depthcli.metrics.boundary import (
    BOUNDARY_NAMES,
    BoundaryScores,
    _edges,
    _log,
    boundary_scores,
    mean_boundary_scores,
)


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
    found = [plain.edges(depth_m.tolist(), valid.tolist()) for depth_m in maps]
    for depth_m, expected in zip(maps, found, strict=True):
        np.testing.assert_array_equal(_edges(_log(depth_m, valid), valid), expected)
        assert np.any(expected)
    scores = boundary_scores(maps[0], maps[1], valid)
    accuracy, completeness = plain.distances(*found)
    assert (scores.dbe_acc, scores.dbe_comp) == pytest.approx((accuracy, completeness), rel=1e-12)
    f1 = plain.edge_f1(maps[0].tolist(), maps[1].tolist(), valid.tolist())
    assert scores.edge_f1 == pytest.approx(f1, rel=1e-9)
    assert 0 < scores.edge_f1 < 1


def _step(column: int, near_m: float = 2.0, far_m: float = 3.0) -> npt.NDArray[np.float64]:
    depth_m = np.full((24, 40), near_m)
    depth_m[:, column:] = far_m
    return depth_m


def test_the_truth_itself_is_perfect() -> None:
    truth = _step(20)
    assert boundary_scores(truth, truth, _everywhere(truth)) == BoundaryScores(0.0, 0.0, 1.0)


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


def test_no_scale_matters() -> None:
    truth, predicted = _scene(1), _scene(2)
    valid = _everywhere(truth)
    one = boundary_scores(truth, predicted, valid)
    other = boundary_scores(truth * 2, predicted * 0.5, valid)
    # The last bit of a logarithm may differ, and one pixel of an edge with it.
    assert dict(other.items()) == pytest.approx(dict(one.items()), rel=0.01)


@pytest.mark.parametrize("predicted", [np.full((24, 40), 2.0), _step(35)])
def test_no_edge_within_ten_pixels_is_ten(predicted: npt.NDArray[np.float64]) -> None:
    truth = _step(20)
    scores = boundary_scores(truth, predicted, _everywhere(truth))
    assert scores == BoundaryScores(10.0, 10.0, 0.0)


def test_a_truth_without_edges_has_no_score() -> None:
    flat = np.full((24, 40), 2.0)
    scores = boundary_scores(flat, _step(20), _everywhere(flat))
    assert all(math.isnan(value) for _, value in scores.items())


def test_missing_edges_cost_completeness_alone() -> None:
    truth = _step(10)
    truth[:, 30:] = 4.5
    scores = boundary_scores(truth, _step(10), _everywhere(truth))
    assert scores.dbe_acc == 0
    assert scores.dbe_comp == pytest.approx(10 / 3)
    assert scores.edge_f1 == pytest.approx(2 / 3)


def test_a_mild_slope_is_no_edge() -> None:
    depth_m = np.tile(np.exp(np.linspace(0, 0.5, 40)), (24, 1))
    assert not _edges(_log(depth_m, _everywhere(depth_m)), _everywhere(depth_m)).any()


def test_the_rim_of_a_hole_is_no_edge() -> None:
    depth_m = np.full((24, 40), 2.0)
    valid = _everywhere(depth_m)
    valid[8:16, 15:25] = False
    depth_m[~valid] = 0
    assert not _edges(_log(depth_m, valid), valid).any()


def test_means_leave_out_images_without_a_score() -> None:
    images = [
        BoundaryScores(1.0, 4.0, 0.5),
        BoundaryScores(math.nan, math.nan, 0.1),
        BoundaryScores(3.0, 6.0, math.nan),
    ]
    assert mean_boundary_scores(images) == BoundaryScores(2.0, 5.0, 0.3)


def test_no_image_has_no_mean() -> None:
    named = dict(mean_boundary_scores(()).items())
    assert tuple(named) == BOUNDARY_NAMES
    assert all(math.isnan(value) for value in named.values())
