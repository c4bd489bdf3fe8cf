import doctest
import math

import numpy as np
import pytest

from depthcli.core.options import Averaging
from depthcli.metrics import depth as accumulate
from depthcli.metrics.depth import METRICS, PixelSums, Scores, mean_scores
from depthcli.metrics.pixels import DepthPixels


def _images() -> list[DepthPixels]:
    rng = np.random.default_rng(1)
    images = []
    for count in (5, 40, 200):
        truth = rng.uniform(0.5, 9.5, count)
        images.append(DepthPixels.of(truth, truth * rng.lognormal(0.1, count / 300, count)))
    return images


def _at_once(name: str, pixels: DepthPixels) -> float:
    """A metric from all pixels at once."""
    metric = METRICS[name]
    return metric.finish(*(total / len(pixels) for total in metric.sums(pixels)))


def _mean(averaging: Averaging, images: list[DepthPixels]) -> Scores:
    return mean_scores(map(PixelSums.of, images), averaging)


@pytest.mark.parametrize("name", METRICS)
def test_averages_count_images_or_pixels_the_same(name: str) -> None:
    images = _images()
    own = [_at_once(name, image) for image in images]
    assert _mean(Averaging.IMAGE, images)[name] == pytest.approx(sum(own) / 3, rel=1e-9)
    together = DepthPixels.of(
        np.concatenate([image.truth_m for image in images]),
        np.concatenate([image.predicted_m for image in images]),
    )
    pooled = _mean(Averaging.POOLED, images)[name]
    assert pooled == pytest.approx(_at_once(name, together), rel=1e-9)


def test_image_without_valid_pixel_is_left_out() -> None:
    one = DepthPixels.of(np.array([2.0]), np.array([3.0]))
    nothing = DepthPixels.of(np.array([0.0]), np.array([3.0]))
    assert math.isnan(PixelSums.of(nothing).scores()["abs_rel"])
    assert _mean(Averaging.IMAGE, [one, nothing])["abs_rel"] == 0.5


@pytest.mark.parametrize("averaging", Averaging)
def test_nothing_seen_is_not_a_number(averaging: Averaging) -> None:
    assert all(math.isnan(value) for value in _mean(averaging, []).values)


def test_scores_by_name() -> None:
    scores = Scores.of(rmse=0.5, d1=0.25)
    assert scores["rmse"] == 0.5
    assert dict(scores.items())["d1"] == 0.25
    assert math.isnan(scores["abs_rel"])


def test_examples_in_the_docstrings() -> None:
    result = doctest.testmod(accumulate)
    assert result.attempted > 0
    assert result.failed == 0


@pytest.mark.parametrize("name", METRICS)
def test_sums_of_parts_are_those_of_the_whole(name: str) -> None:
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.5, 9.5, 100_000)
    pixels = DepthPixels.of(truth, truth * rng.lognormal(0.1, 0.3, truth.size))
    assert [len(part) for part in pixels.parts()][-1] < len(pixels)
    assert sum(len(part) for part in pixels.parts()) == len(pixels)
    assert PixelSums.of(pixels).scores()[name] == pytest.approx(_at_once(name, pixels), rel=1e-12)
