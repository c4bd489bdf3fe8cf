"""Resizing, colours, output coding and metres for other cameras, against plain formulas."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.core.codec import DepthCodec, Transform
from depthcli.core.colour import luma, rgb, value_channel
from depthcli.core.resize import resize_area, resize_bilinear
from depthcli.core.scaling import fit_anchors, focal_px_of_35mm, focal_px_of_hfov, hfov_deg
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import UsageError

RANDOM = np.random.default_rng(3)


class Point(NamedTuple):
    x: int
    y: int
    depth_m: float


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


def test_linear_coding_is_the_paper_s() -> None:
    depth_m = DepthCodec.linear_m(10).decode(np.float32([-1, 0, 0.5, 1]))
    assert depth_m == pytest.approx([0, 5, 7.5, 10])
    assert DepthCodec().decode(np.float32([3])) == pytest.approx([3])


def test_log_coding_puts_its_ends_at_minus_one_and_one() -> None:
    ends = DepthCodec.log_m(0.4, 10).decode(np.array([-1, 1], np.float32))
    assert ends == pytest.approx([0.4, 10], rel=1e-5)


def test_reciprocal_of_nothing_is_infinitely_far() -> None:
    codec = DepthCodec(Transform.RECIPROCAL)
    with np.errstate(all="raise"):
        assert codec.decode(np.float32([0, -1, 4])).tolist() == [math.inf, math.inf, 0.25]


def test_focal_lengths() -> None:
    assert focal_px_of_hfov(63.3, 640) == pytest.approx(518.86, rel=2e-3)
    assert focal_px_of_hfov(90, 1000) == pytest.approx(500)
    assert focal_px_of_35mm(36, 360, 240) == pytest.approx(360)
    with pytest.raises(UsageError):
        focal_px_of_hfov(180, 640)


@given(st.floats(0.1, 179.9), st.integers(1, 20_000))
def test_a_field_of_view_is_that_of_its_focal_length(degrees: float, width: int) -> None:
    assert hfov_deg(focal_px_of_hfov(degrees, width), width) == pytest.approx(degrees)


@pytest.mark.parametrize("kind", list(DepthKind))
def test_anchors_recover_scale_and_shift(kind: DepthKind) -> None:
    truth_m = RANDOM.uniform(1, 9, (8, 10))
    seen = 1 / truth_m if kind is DepthKind.INVERSE else truth_m
    depth = DepthMap(((seen - 0.05) / 1.7).astype(np.float32), kind)
    points = [Point(x, y, float(truth_m[y, x])) for x, y in [(0, 0), (9, 7), (4, 2)]]
    fitted = fit_anchors(depth, points)
    assert fitted.kind is DepthKind.METRIC
    assert fitted.values == pytest.approx(truth_m, rel=1e-3)


def test_one_anchor_fits_the_scale() -> None:
    depth = DepthMap(np.array([[1.0, 2.0]], np.float32))
    assert fit_anchors(depth, [Point(1, 0, 3.0)]).values == pytest.approx(np.array([[1.5, 3.0]]))


def test_two_anchors_one_unit_apart_fit_scale_and_shift() -> None:
    depth = DepthMap(np.float32([[1, 2, 3]]), DepthKind.RELATIVE)
    fitted = fit_anchors(depth, [Point(0, 0, 3.0), Point(1, 0, 7.0)])
    assert fitted.values == pytest.approx(np.array([[3, 7, 11]]))


def test_what_the_fit_puts_behind_the_camera_has_no_depth() -> None:
    near_and_far = [Point(2, 0, 1.0), Point(3, 0, 4.0)]  # depth = 3 × value − 5
    depth = DepthMap(np.float32([[0.0, 1.6, 2.0, 3.0]]), DepthKind.RELATIVE)
    fitted = fit_anchors(depth, near_and_far)
    np.testing.assert_allclose(fitted.values, [[np.nan, np.nan, 1, 4]], rtol=1e-5)
    inverse = DepthMap(np.float32([[0.0, 0.49, 1.0, 0.625]]), DepthKind.INVERSE)
    fitted = fit_anchors(inverse, near_and_far)  # 1 / depth = 2 × value − 1
    np.testing.assert_allclose(fitted.values, [[np.nan, np.nan, 1, 4]], rtol=1e-5)
    nothing = DepthMap(np.float32([[0.0, 2.0]]), DepthKind.RELATIVE)
    np.testing.assert_allclose(fit_anchors(nothing, [Point(1, 0, 3.0)]).values, [[np.nan, 3]])


@pytest.mark.parametrize("kind", list(DepthKind))
def test_an_anchor_behind_the_camera_is_refused(kind: DepthKind) -> None:
    """The best line through these three is below 0 at one of them."""
    values = np.float32([[0.0, 1.0, 2.0]])
    wanted = (0.01, 0.02, 3.0)
    points = [
        Point(x, 0, 1 / value if kind is DepthKind.INVERSE else value)
        for x, value in enumerate(wanted)
    ]
    with pytest.raises(UsageError, match="ahead of the camera"):
        fit_anchors(DepthMap(values, kind), points)


@pytest.mark.parametrize("value", [0.0, -2.0])
@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_one_anchor_never_turns_near_into_far(value: float, kind: DepthKind) -> None:
    depth = DepthMap(np.float32([[value, 1.0]]), kind)
    with pytest.raises(UsageError, match="two anchors"):
        fit_anchors(depth, [Point(0, 0, 3.0)])


@pytest.mark.parametrize(
    ("points", "why"),
    [
        ([Point(3, 0, 1)], "outside the picture of 3×1"),
        ([Point(0, 1, 1)], "outside the picture of 3×1"),
        ([Point(2, 0, 1)], "no depth"),
        ([Point(0, 0, 2), Point(1, 0, 1)], "contradict"),
        ([Point(0, 0, 1), Point(0, 0, 2)], "all anchors have the same depth"),
        ([Point(0, 0, 0.0)], "give one above 0"),
        ([Point(0, 0, math.inf)], "give one above 0"),
        ([], "there are no anchors"),
    ],
)
def test_impossible_anchors_are_refused(points: list[Point], why: str) -> None:
    depth = DepthMap(np.array([[1.0, 2.0, np.nan]], np.float32))
    with pytest.raises(UsageError, match=why):
        fit_anchors(depth, points)
