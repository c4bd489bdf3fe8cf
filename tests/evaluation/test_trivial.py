import numpy as np
import pytest
from helpers import plain_evaluator as plain
from helpers.small_set import HEIGHT, WIDTH, small_set
from helpers.watched import Watched

from depthcli.errors import DatasetError
from depthcli.evaluation.predictors import fit_trivial


def test_means_equal_the_plain_loop() -> None:
    dataset = small_set()
    dataset.depths_m[:, 0, 0] = 0
    dataset.depths_m[:, 0, 1] = [0, 3, 0, 0, 5, 0]
    constant, per_pixel = fit_trivial(dataset, (0, 1, 4))
    images = [dataset.depths_m[i].tolist() for i in (0, 1, 4)]
    valid = [v for image in images for line in image for v in line if 1e-3 < v < 10]
    assert np.ptp(constant.depth.values) == 0
    assert constant.depth.values[0, 0] == pytest.approx(plain.mean(valid), rel=1e-6)
    for y in range(HEIGHT):
        for x in range(WIDTH):
            here = [image[y][x] for image in images if 1e-3 < image[y][x] < 10]
            expected = plain.mean(here) if here else plain.mean(valid)
            assert per_pixel.depth.values[y, x] == pytest.approx(expected, rel=1e-6)
    assert per_pixel.depth.values[0, 1] == 4.0


def test_only_depth_inside_the_range_counts() -> None:
    dataset = small_set(1, shape=(1, 4))
    dataset.depths_m[:] = [[[0.5, 0.75, 1.25, 2.0]]]
    constant, per_pixel = fit_trivial(dataset, (0,), min_m=0.5, max_m=2.0)
    assert constant.depth.values.tolist() == [[1.0] * 4]
    assert per_pixel.depth.values.tolist() == [[1.0, 0.75, 1.25, 1.0]]


def test_only_training_pairs_are_read() -> None:
    dataset = small_set()
    watched = Watched()
    fit_trivial(dataset, (1, 3), progress=watched)
    assert dataset.depth_reads == {1: 1, 3: 1}
    assert dataset.image_reads == {}
    assert watched.stages == {"mean of training images": (2, 2)}


def test_no_training_pair() -> None:
    with pytest.raises(DatasetError):
        fit_trivial(small_set(), ())


def test_training_pairs_without_depth() -> None:
    dataset = small_set()
    dataset.depths_m[...] = 0
    with pytest.raises(DatasetError):
        fit_trivial(dataset, (0, 1))


def test_training_pairs_of_different_sizes() -> None:
    class Mixed:
        ids = ("a", "b")

        def depth_m(self, i: int) -> np.ndarray:
            return np.full((2, 2 + i), 3, np.float32)

    with pytest.raises(DatasetError):
        fit_trivial(Mixed(), (0, 1))
