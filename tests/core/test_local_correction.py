"""Corrections that are spread from known points over a map."""

import numpy as np
import pytest

from depthcli.core.local_correction import _Level, spread_log_ratio

HEIGHT, WIDTH = 30, 40


def test_layers_are_between_nodes_and_end_with_the_last() -> None:
    level = _Level(0.2, np.zeros((3, 1)), HEIGHT / WIDTH, -0.5, 1.5)
    assert level.nodes[1:] == (4, 5)
    assert level.depth_step == pytest.approx(0.3 * 0.5**0.5)
    field = np.random.default_rng(0).normal(size=level.nodes)
    mixed = 0.75 * field[1] + 0.25 * field[2]
    for place, expected in (0, field[0]), (1.25, mixed), (99, field[-1]):
        found = level.layer(field, place * level.depth_step, (5, 4))
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_correction_is_that_of_the_constants_that_were_measured() -> None:
    """A box, of another ratio, before a wall that recedes; one point in ten is wrong.

    docs/cameras.md states the errors with these constants.
    """
    random = np.random.default_rng(1)
    depth_m = np.tile(np.linspace(2, 5, WIDTH, dtype=np.float32), (HEIGHT, 1))
    depth_m[8:20, 10:25] = 1
    depth_m[0, 0] = np.nan
    x, y = random.integers(1, WIDTH, 150), random.integers(1, HEIGHT, 150)
    log_ratio = np.where(depth_m[y, x] == 1, 0.3, 0.1 * x / WIDTH) + random.normal(0, 0.01, 150)
    log_ratio[:15] += random.uniform(0.5, 1, 15)
    found, followed = spread_log_ratio(log_ratio, x, y, depth_m, random.random(150) < 0.9)
    assert (found.shape, found.dtype, found[0, 0]) == ((HEIGHT, WIDTH), np.float32, 0)
    assert (followed[:15].sum(), followed.sum()) == (0, 127)
    places = [14, 14, 2, 28, 25], [12, 23, 5, 37, 20]
    expected = [0.3080706, 0.29670805, 0.0185575, 0.08938435, 0.0509098]
    assert found[places] == pytest.approx(expected, rel=2e-4)
    spread = found.mean(dtype=float), found.std(dtype=float)
    assert spread == pytest.approx((0.08698672, 0.09493492), rel=2e-5)
