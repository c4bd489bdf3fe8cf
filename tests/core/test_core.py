"""Resizing, colours, output coding and metres for other cameras, against plain formulas."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.core.camera import Intrinsics, focal_px_of_35mm, focal_px_of_hfov, hfov_deg
from depthcli.core.imageops import luma, resize_area, resize_bilinear, rgb, value_channel
from depthcli.core.types import DepthCodec, Transform
from depthcli.errors import UsageError

RANDOM = np.random.default_rng(3)


def plain_bilinear(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """Half-pixel centres, edges repeated, one pixel at a time."""
    rows, columns = values.shape
    out = np.empty((height, width))
    for i in range(height):
        y = min(max((i + 0.5) * rows / height - 0.5, 0), rows - 1)
        for j in range(width):
            x = min(max((j + 0.5) * columns / width - 0.5, 0), columns - 1)
            top, left = int(y), int(x)
            low, right = min(top + 1, rows - 1), min(left + 1, columns - 1)
            fy, fx = y - top, x - left
            above = values[top, left] * (1 - fx) + values[top, right] * fx
            below = values[low, left] * (1 - fx) + values[low, right] * fx
            out[i, j] = above * (1 - fy) + below * fy
    return out


@pytest.mark.parametrize("size", [(13, 7), (4, 3), (5, 11), (1, 1)])
def test_bilinear_has_half_pixel_centres(size: tuple[int, int]) -> None:
    values = RANDOM.random((5, 6), np.float32)
    assert resize_bilinear(values, *size) == pytest.approx(plain_bilinear(values, *size), abs=1e-5)


def test_area_is_the_mean_where_it_shrinks() -> None:
    values = RANDOM.random((6, 8), np.float32)
    means = values.reshape(3, 2, 4, 2).mean((1, 3))
    assert resize_area(values, 4, 3) == pytest.approx(means, abs=1e-6)


def test_area_is_bilinear_along_an_axis_that_grows() -> None:
    values = RANDOM.random((6, 8), np.float32)
    rows = values.reshape(3, 2, 8).mean(1)
    assert resize_area(values, 16, 3) == pytest.approx(plain_bilinear(rows, 16, 3), abs=1e-5)


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
def test_value_is_the_largest_channel_at_full_precision(dtype: type, top: int) -> None:
    pixels = RANDOM.integers(0, top, (4, 5, 3)).astype(dtype)
    wanted = [[max(map(int, pixel)) / top for pixel in row] for row in pixels]
    assert value_channel(pixels) == pytest.approx(np.array(wanted), abs=1e-7)
    assert value_channel(pixels[..., 0]) == pytest.approx(pixels[..., 0] / top, abs=1e-7)
    weighted = pixels / top @ np.array([0.299, 0.587, 0.114])
    assert luma(pixels) == pytest.approx(weighted, abs=1e-6)
    assert rgb(pixels[..., 0]).shape == (4, 5, 3)


def test_float_pixels_are_kept_within_zero_and_one() -> None:
    pixels = np.float32([[-0.5, 0.25, 1.5]])
    assert value_channel(pixels).tolist() == [[0, 0.25, 1]]


@pytest.mark.parametrize(
    ("codec", "depth"),
    [
        (DepthCodec.linear_m(10), 9.0),
        (DepthCodec.log_m(0.4, 10), 0.4 * 25**0.9),
        (DepthCodec(Transform.RECIPROCAL, 0.5, 1), 1 / 1.4),
    ],
)
def test_decoding_is_its_formula(codec: DepthCodec, depth: float) -> None:
    assert codec.decode(np.float32([0.8]))[0] == pytest.approx(depth, rel=1e-6)
    assert codec.times(1.03).decode(np.float32([0.8]))[0] == pytest.approx(1.03 * depth, rel=1e-6)


def test_linear_coding_is_the_paper_s() -> None:
    depth_m = DepthCodec.linear_m(10).decode(np.float32([-1, 0, 0.5, 1]))
    assert depth_m == pytest.approx([0, 5, 7.5, 10])
    assert DepthCodec().decode(np.float32([3])) == pytest.approx([3])


def test_log_coding_puts_its_ends_at_minus_one_and_one() -> None:
    ends = DepthCodec.log_m(0.4, 10).decode(np.array([-1, 1], np.float32))
    assert ends == pytest.approx([0.4, 10], rel=1e-5)


@pytest.mark.parametrize("transform", Transform)
def test_nonfinite_values_are_invalid(transform: Transform) -> None:
    assert np.isnan(DepthCodec(transform).decode(np.float32([math.nan]))).all()


def test_reciprocal_of_nothing_is_infinitely_far() -> None:
    codec = DepthCodec(Transform.RECIPROCAL)
    with np.errstate(all="raise"):
        assert codec.decode(np.float32([0, -1, 4])).tolist() == [math.inf, math.inf, 0.25]


def test_focal_lengths() -> None:
    assert focal_px_of_hfov(63.3, 640) == pytest.approx(518.86, rel=2e-3)
    assert focal_px_of_hfov(90, 1000) == pytest.approx(500)
    assert focal_px_of_35mm(36, 360, 240) == pytest.approx(360)
    with pytest.raises(UsageError):
        Intrinsics(hfov_deg=180)


@given(st.floats(0.1, 179.9), st.integers(1, 20_000))
def test_a_field_of_view_is_that_of_its_focal_length(degrees: float, width: int) -> None:
    assert hfov_deg(focal_px_of_hfov(degrees, width), width) == pytest.approx(degrees)
