"""Upsampling that looks at the image, bands, and resizing as other libraries do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
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


def scene(off: int = 0) -> tuple[np.ndarray, np.ndarray, Frame]:
    """True depth, the coarse map of it, and an image: dark before bright, the edge 4 px a cell."""
    true = np.full((96, 128), 3.0, np.float32)
    true[:, : 50 + off] = 1.5
    coarse = resize_area(true, 32, 24)
    return true, coarse, Frame(np.where(true < 2, 60, 180).astype(np.uint8))


def window(values: np.ndarray, y: int, x: int, radius: int) -> np.ndarray:
    """The values around a pixel, the edges repeated."""
    rows = np.clip(np.arange(y - radius, y + radius + 1), 0, values.shape[0] - 1)
    columns = np.clip(np.arange(x - radius, x + radius + 1), 0, values.shape[1] - 1)
    return values[np.ix_(rows, columns)]


@pytest.mark.parametrize("radius", [1, 2])
def test_lines_are_those_of_a_plain_loop(radius: int) -> None:
    """He, Sun and Tang, eq. 5 and 6, with the gain; then the mean over all windows of a pixel."""
    rng = np.random.default_rng(5)
    coarse, guide = rng.uniform(2, 3, (7, 9)), rng.uniform(0, 0.2, (7, 9))
    slope, offset, low, high = (np.empty((7, 9)) for _ in range(4))
    for y, x in np.ndindex(7, 9):
        depth, bright = window(coarse, y, x, radius), window(guide, y, x, radius)
        covariance = (depth * bright).mean() - depth.mean() * bright.mean()
        slope[y, x] = 1.5 * covariance / (bright.var() + 1e-3)
        offset[y, x] = depth.mean() - slope[y, x] * bright.mean()
        low[y, x], high[y, x] = depth.min(), depth.max()
    lines = guided_coefficients(np.float32(coarse), np.float32(guide), radius)
    for found, single in zip(lines[:2], (slope, offset), strict=True):
        expected = [[window(single, y, x, radius).mean() for x in range(9)] for y in range(7)]
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(lines[2], low, rtol=1e-6)
    np.testing.assert_allclose(lines[3], high, rtol=1e-6)


def test_edges_are_made_steeper_as_in_a_plain_loop() -> None:
    rng = np.random.default_rng(6)
    coarse = np.where(np.arange(20) < 9, 0.3, 0.7) + rng.uniform(0, 0.06, (9, 20))
    coarse, guide = np.float32(coarse), np.float32(rng.uniform(0, 0.2, (9, 20)))
    plain, steep = (guided_coefficients(coarse, guide, sharpens=sharpens) for sharpens in (0, 1))
    gains = set()
    for y, x in np.ndindex(9, 20):
        near, wide = window(coarse, y, x, 2), window(coarse, y, x, 4)
        is_large = min(max(2 * (np.ptp(near) / 0.1 - 1), 0), 1)
        is_complete = min(max((np.ptp(near) / np.ptp(wide) - 0.5) / 0.3, 0), 1)
        is_inside = 4 <= y < 5 and 4 <= x < 16
        gains.add(gain := 1 + 3 * is_large * is_complete * is_inside)
        middle = (near.min() + near.max()) / 2
        for bright in (0.0, 1.0):
            value = plain[0][y, x] * bright + plain[1][y, x]
            found = steep[0][y, x] * bright + steep[1][y, x]
            assert found == pytest.approx(middle + gain * (value - middle), abs=1e-4)
    assert {1, 4} <= gains


def test_a_smeared_edge_is_steep_and_a_slope_stays() -> None:
    plain = Frame(np.full((360, 480), 128, np.uint8))
    edge = np.float32([2] * 46 + [2.67, 3.33] + [4] * 48)[None].repeat(72, 0)
    row = upsample_guided(edge, plain, in_log=True)[120]
    smeared = resize_bilinear(edge, 480, 360)[120]
    between = [np.count_nonzero((values > 2.2) & (values < 3.8)) for values in (row, smeared)]
    assert between[0] < 0.5 * between[1]
    slope = np.geomspace(1, 9, 96, dtype=np.float32)[None].repeat(72, 0)
    found, wanted = (upsample_guided(slope, plain, in_log=log)[120] for log in (True, False))
    np.testing.assert_allclose(found, wanted, rtol=0.01)


@pytest.mark.parametrize("off", range(4))
def test_edges_follow_the_image_s(off: int) -> None:
    true, coarse, frame = scene(off)
    guided = upsample_guided(coarse, frame, in_log=True)
    bilinear = resize_bilinear(coarse, 128, 96)
    assert np.abs(guided - true).mean() < 0.4 * np.abs(bilinear - true).mean()
    steepest = np.abs(np.diff(guided, axis=1)).argmax(axis=1)
    assert (steepest == 50 + off - 1).all()


def test_the_radius_is_that_of_the_network_s_pixels() -> None:
    true, coarse, frame = scene()
    fine = resize_bilinear(coarse, 64, 48)
    errors = [
        np.abs(upsample_guided(fine, frame, in_log=False, radius=radius) - true).mean()
        for radius in (1, 2)
    ]
    assert errors[1] < 0.7 * errors[0]


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_depth_is_never_invented(seed: int, in_log: bool) -> None:
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0.5, 9, (6, 8)).astype(np.float32)
    frame = Frame(rng.integers(0, 256, (30, 40, 3), dtype=np.uint8))
    values = upsample_guided(coarse, frame, in_log=in_log)
    reach = 3 if in_log else 2  # edges of log depth are sharpened
    rows, columns = np.mgrid[0:30, 0:40] // 5
    for y in range(6):
        for x in range(8):
            near = coarse[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1]
            here = values[(rows == y) & (columns == x)]
            assert near.min() * (1 - 1e-5) <= here.min()
            assert here.max() <= near.max() * (1 + 1e-5)


@pytest.mark.parametrize("size", [(10, 14), (8, 200), (200, 10)])
def test_an_image_no_larger_than_the_map_is_bilinear(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    coarse = rng.uniform(1, 2, (10, 14)).astype(np.float32)
    frame = Frame(rng.integers(0, 256, size, dtype=np.uint8))
    expected = resize_bilinear(coarse, size[1], size[0])
    np.testing.assert_array_equal(upsample_guided(coarse, frame, in_log=True), expected)


def test_a_hole_does_not_grow() -> None:
    coarse = np.full((10, 14), 2.0, np.float32)
    coarse[5, 5] = np.nan
    values = upsample_guided(coarse, Frame(np.zeros((50, 70), np.uint8)), in_log=False)
    np.testing.assert_array_equal(values, resize_bilinear(coarse, 70, 50))


def test_bands_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    coarse = rng.uniform(1, 2, (6, 8)).astype(np.float32)
    frame = Frame(rng.integers(0, 256, (61, 83, 3), dtype=np.uint8))
    whole = upsample_guided(coarse, frame, in_log=True)
    monkeypatch.setattr(bands, "BAND_PIXELS", 500)
    np.testing.assert_allclose(upsample_guided(coarse, frame, in_log=True), whole, rtol=1e-5)


def test_texture_that_depth_does_not_follow_is_not_copied() -> None:
    slope = np.broadcast_to(np.linspace(2, 4, 32, dtype=np.float32), (24, 32)).copy()
    checks = np.indices((96, 128)).sum(axis=0) // 2 % 2
    guided = upsample_guided(slope, Frame((60 + 120 * checks).astype(np.uint8)), in_log=True)
    inside = slice(8, -8), slice(8, -8)
    change = guided[inside] / resize_bilinear(slope, 128, 96)[inside] - 1
    assert np.abs(change).max() < 0.01


def test_texture_of_a_plane_is_not_seen_in_log_depth() -> None:
    plane = 1 / np.linspace(0.4, 0.8, 64, dtype=np.float32)[:, None].repeat(64, 1)  # a floor
    texture = np.random.default_rng(0).integers(0, 256, (64, 64), np.uint8)
    frame = Frame(texture.repeat(4, 0).repeat(4, 1))
    smooth = resize_bilinear(plane, 256, 256)
    guided, of_metres = (upsample_guided(plane, frame, in_log=log) for log in (True, False))
    inside = slice(16, -16), slice(16, -16)
    changes = [np.abs(each / smooth - 1)[inside].max() for each in (guided, of_metres)]
    assert changes[0] < 0.2 * changes[1]


SIZES = [(13, 7), (50, 40), (60, 150), (200, 150)]


@pytest.mark.parametrize("size", SIZES)
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


@pytest.mark.parametrize("size", [(16, 12), (7, 90), (300, 5)])
def test_shrinking_by_bands_is_shrinking(
    monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    monkeypatch.setattr(bands, "BAND_PIXELS", 1000)
    pixels = np.random.default_rng(4).integers(0, 256, (67, 101, 3), dtype=np.uint8)
    assert [rows.stop for rows in bands.row_bands(101, 67)] == [10, 20, 30, 40, 50, 60, 67]
    found = bands.shrink_bands(pixels, bands.luma, *size)
    np.testing.assert_allclose(found, resize_area(bands.luma(pixels), *size), atol=2e-6)


def test_a_sample_is_bilinear_between_the_middles_of_pixels() -> None:
    values = np.random.default_rng(2).random((3, 4), np.float32)
    row, column = np.float64([[0.5, 0], [1, 0.5], [3, 3.75], [2, 2]]).T  # in pixels
    found = bands.sample_bilinear(values, row / 3, column / 4)
    expected = values[0, 0], values[:2, 0].mean(), values[2, 3], values[1:, 1:3].mean()
    assert found == pytest.approx(expected, abs=1e-6)


def test_corners_keep_their_place() -> None:
    values = np.random.default_rng(2).random((5, 7), dtype=np.float32)
    ours = resize_corners(values, 19, 4)
    for row in range(4):
        for column in range(19):
            y, x = row * 4 / 3, column * 6 / 18
            top, left = min(int(y), 3), min(int(x), 5)
            (a, b), (c, d) = values[top : top + 2, left : left + 2]
            down, across = y - top, x - left
            upper, lower = a + across * (b - a), c + across * (d - c)
            assert ours[row, column] == pytest.approx(upper + down * (lower - upper), abs=1e-5)
