"""Upsampling that looks at the image, bands, and resizing as other libraries do."""

from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from depthcli.core import imageops as bands
from depthcli.core.imageops import (
    guided_coefficients,
    resize_antialiased,
    resize_area,
    resize_bilinear,
    resize_corners,
    upsample_guided,
)
from depthcli.core.types import Frame


def window(values: np.ndarray, y: int, x: int, radius: int) -> np.ndarray:
    """The values around a pixel, the edges repeated."""
    rows = np.clip(np.arange(y - radius, y + radius + 1), 0, values.shape[0] - 1)
    columns = np.clip(np.arange(x - radius, x + radius + 1), 0, values.shape[1] - 1)
    return values[np.ix_(rows, columns)]


def plain_coefficients(
    coarse: np.ndarray, guide: np.ndarray, radius: int, *, sharpens: bool
) -> tuple[np.ndarray, ...]:
    """He, Sun and Tang, eq. 5 and 6, with the gains; then the mean over all windows of a pixel."""

    def over(values: np.ndarray, function: Callable[[np.ndarray], float], reach: int) -> np.ndarray:
        every = [function(window(values, y, x, reach)) for y, x in np.ndindex(values.shape)]
        return np.reshape(every, values.shape)

    mean, bright = over(coarse, np.mean, radius), over(guide, np.mean, radius)
    covariance = over(coarse * guide, np.mean, radius) - mean * bright
    slope = 1.5 * covariance / (over(guide, np.var, radius) + 1e-3)
    if sharpens:
        bend = over(abs(coarse - mean), np.max, 2 * radius)
        slope *= ((bend / 0.003 - 1) / 2).clip(0, 1)
    slope, offset = (over(v, np.mean, radius) for v in (slope, mean - slope * bright))
    reach = 2 * radius if sharpens else radius
    low, high = over(coarse, np.min, reach), over(coarse, np.max, reach)
    if sharpens:
        change, wider, margin = high - low, over(coarse, np.ptp, 4 * radius), 4 * radius
        is_large = (2 * (change / 0.1 - 1)).clip(0, 1)
        is_complete = ((change / wider - 0.5) / 0.3).clip(0, 1)
        is_inside = np.pad(np.ones(np.subtract(coarse.shape, 2 * margin)), margin)
        gain = 1 + 3 * is_large * is_complete * is_inside
        slope, offset = slope * gain, offset * gain + (low + high) / 2 * (1 - gain)
    return slope, offset, low, high


@pytest.mark.parametrize("radius", [1, 2])
@pytest.mark.parametrize("sharpens", [False, True])
def test_lines_are_those_of_a_plain_loop(radius: int, *, sharpens: bool) -> None:
    random, (rows, columns) = np.random.default_rng(5), np.mgrid[:22, :40]
    step = np.where(columns < 17, 0.3, 0.3 + 0.02 * rows)
    coarse = np.float32(step + random.uniform(0, 0.002, (22, 40)) * columns)
    coarse += 0 if sharpens else 4096  # wherever depth begins, the line is as precise
    guide = random.uniform(0, 0.2, (22, 40))
    coefficients = guided_coefficients(coarse, np.float32(guide), radius, sharpens=sharpens)
    expected = plain_coefficients(coarse.astype(float), guide, radius, sharpens=sharpens)
    np.testing.assert_allclose(coefficients, expected, rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("shape", [(7, 9), (48, 50), (47, 99)])
@pytest.mark.parametrize("in_log", [False, True])
def test_upsampling_clamps_the_line_of_each_place(
    shape: tuple[int, int], in_log: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(2)
    coarse = random.uniform(1, 2, shape).astype(np.float32)
    frame = Frame(random.integers(0, 256, (101, 103, 3), dtype=np.uint8))
    bright = bands.brightness(frame.pixels)
    map_values, small = np.log(coarse) if in_log else coarse, resize_area(bright, *shape[::-1])
    lines = guided_coefficients(map_values, small, 2, sharpens=in_log and shape[0] >= 48)
    slope, offset, low, high = (resize_bilinear(line, 103, 101) for line in lines)
    values = (slope * bright + offset).clip(low, high)
    for pixels in (160_000, 500):
        monkeypatch.setattr(bands, "BAND_PIXELS", pixels)
        upsampled = upsample_guided(coarse, frame, in_log=in_log, radius=2)
        np.testing.assert_allclose(upsampled, np.exp(values) if in_log else values, rtol=1e-5)
    assert [rows.stop for rows in bands.row_bands(103, 101)] == [*range(5, 101, 5), 101]


@pytest.mark.parametrize("size", [(10, 14), (8, 200), (200, 10), (50, 70)])
def test_an_image_no_larger_than_the_map_or_one_with_holes_is_bilinear(
    size: tuple[int, int],
) -> None:
    random = np.random.default_rng(1)
    coarse = random.uniform(1, 2, (10, 14)).astype(np.float32)
    coarse[5, 5] = np.nan if size == (50, 70) else 1
    frame = Frame(random.integers(0, 256, size, dtype=np.uint8))
    expected = resize_bilinear(coarse, size[1], size[0])
    np.testing.assert_array_equal(upsample_guided(coarse, frame, in_log=True), expected)


def test_a_smeared_edge_is_steep_and_a_slope_stays() -> None:
    plain = Frame(np.full((360, 480), 128, np.uint8))
    edge = np.float32([2] * 46 + [2.67, 3.33] + [4] * 48)[None].repeat(72, 0)
    row = upsample_guided(edge, plain, in_log=True)[120]
    smeared = resize_bilinear(edge, 480, 360)[120]
    between = [np.count_nonzero((values > 2.2) & (values < 3.8)) for values in (row, smeared)]
    assert between[0] < 0.5 * between[1]
    slope = np.geomspace(1, 9, 96, dtype=np.float32)[None].repeat(72, 0)
    in_log, linear = (upsample_guided(slope, plain, in_log=log)[120] for log in (True, False))
    np.testing.assert_allclose(in_log, linear, rtol=0.01)


@pytest.mark.parametrize("off", range(4))
def test_edges_follow_the_image_s(off: int) -> None:
    true = np.full((96, 128), 3.0, np.float32)
    true[:, : 50 + off] = 1.5
    coarse = resize_area(true, 32, 24)
    frame = Frame(np.where(true < 2, 60, 180).astype(np.uint8))
    guided = upsample_guided(coarse, frame, in_log=True)
    bilinear = resize_bilinear(coarse, 128, 96)
    assert np.abs(guided - true).mean() < 0.4 * np.abs(bilinear - true).mean()
    steepest = np.abs(np.diff(guided, axis=1)).argmax(axis=1)
    assert (steepest == 50 + off - 1).all()


def test_texture_of_a_plane_is_not_seen_in_log_depth() -> None:
    plane = 1 / np.linspace(0.4, 0.8, 64, dtype=np.float32)[:, None].repeat(64, 1)  # a floor
    texture = np.random.default_rng(0).integers(0, 256, (64, 64), np.uint8)
    frame = Frame(texture.repeat(4, 0).repeat(4, 1))
    smooth = resize_bilinear(plane, 256, 256)
    guided, of_metres = (upsample_guided(plane, frame, in_log=log) for log in (True, False))
    inside = slice(16, -16), slice(16, -16)
    changes = [np.abs(each / smooth - 1)[inside].max() for each in (guided, of_metres)]
    assert changes[0] < 0.2 * changes[1]


@pytest.mark.parametrize("size", [(13, 7), (50, 40), (60, 150), (200, 150)])
@pytest.mark.parametrize("cubic", [False, True])
def test_antialiased_is_that_of_pillow(size: tuple[int, int], cubic: bool) -> None:
    values = np.random.default_rng(0).random((97, 133), dtype=np.float32)
    method = Image.Resampling.BICUBIC if cubic else Image.Resampling.BILINEAR
    theirs = np.asarray(Image.fromarray(values).resize(size, method))
    np.testing.assert_allclose(resize_antialiased(values, *size, cubic=cubic), theirs, atol=1e-6)
    levels = np.random.default_rng(1).integers(0, 256, (97, 133, 3), np.uint8)
    theirs = np.asarray(Image.fromarray(levels).resize(size, method))
    ours = resize_antialiased(levels / np.float32(255), *size, cubic=cubic, eight_bit=True) * 255
    np.testing.assert_array_equal(np.rint(ours), theirs)


def test_area_is_the_mean_where_it_shrinks_and_bilinear_where_it_grows() -> None:
    values = np.random.default_rng(0).random((6, 8, 3), np.float32)
    rows, columns = values.reshape(3, 2, 8, 3).mean(1), values.reshape(6, 4, 2, 3).mean(2)
    means = values.reshape(3, 2, 4, 2, 3).mean((1, 3))
    np.testing.assert_allclose(resize_area(values, 4, 3), means, atol=1e-6)
    np.testing.assert_allclose(resize_area(values, 16, 3), resize_bilinear(rows, 16, 3), atol=1e-6)
    np.testing.assert_allclose(resize_area(values, 4, 9), resize_bilinear(columns, 4, 9), atol=1e-6)


def test_a_sample_is_bilinear_between_the_middles_of_pixels() -> None:
    values = np.random.default_rng(2).random((3, 4), np.float32)
    row, column = np.float64([[0.5, 0], [1, 0.5], [3, 3.75], [2, 2]]).T  # in pixels
    sampled = bands.sample_bilinear(values, row / 3, column / 4)
    expected = values[0, 0], values[:2, 0].mean(), values[2, 3], values[1:, 1:3].mean()
    assert sampled == pytest.approx(expected, abs=1e-6)


def test_corners_keep_their_place() -> None:
    def stretched(values: np.ndarray, count: int) -> np.ndarray:
        places, rows = np.linspace(0, len(values) - 1, count), np.arange(len(values))
        return np.apply_along_axis(lambda line: np.interp(places, rows, line), 0, values)

    values = np.random.default_rng(2).random((5, 7, 2), dtype=np.float32)
    expected = stretched(stretched(values, 4).swapaxes(0, 1), 19).swapaxes(0, 1)
    np.testing.assert_allclose(resize_corners(values, 19, 4), expected, atol=1e-5)
