"""What the network sees: colour at full precision, size, normalization."""

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, strategies as st

from depthcli.core.imageops import resize_bilinear
from depthcli.core.options import Upsampling
from depthcli.core.types import DepthKind, Frame, Transform
from depthcli.inference.transforms import (
    Layout,
    _on_grid_of,
    blends_in_log,
    coarse_depth,
    full_size,
    input_layout,
    lacks_depth,
    prepare,
)
from depthcli.known.points import KnownDepth
from depthcli.models.card import Colour, Fit, InputSpec, MaskSpec, OutputSpec


def spec(**changes: Any) -> InputSpec:
    plain = InputSpec(Colour.VALUE, 16, 12, True, 1, Fit.STRETCH, mean=(0.0,), std=(1.0,))
    return replace(plain, **changes)


def output(
    kind: DepthKind = DepthKind.METRIC, transform: Transform = Transform.LINEAR
) -> OutputSpec:
    return OutputSpec(kind, transform, 1.0, 0.0, 0.5, 10.0)


def test_channels_are_red_green_blue_each_with_its_mean_and_std() -> None:
    pixels = np.broadcast_to(np.uint8([255, 51, 0]), (12, 16, 3))
    rgb = spec(colour=Colour.RGB, mean=(0.5, 0.1, 0.0), std=(0.5, 0.1, 0.2))
    batch, _ = prepare(rgb, Frame(np.ascontiguousarray(pixels)))
    assert batch.shape == (1, 3, 12, 16)
    assert batch.dtype == np.float32
    np.testing.assert_allclose(batch[0, :, 0, 0], [1, 1, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("colour", "expected"), [(Colour.VALUE, 25701 / 65535), (Colour.LUMA, 0.587 * 25701 / 65535)]
)
def test_one_channel_keeps_sixteen_bits(colour: Colour, expected: float) -> None:
    pixels = np.zeros((12, 16, 3), np.uint16)
    pixels[..., 1] = 25701  # green
    batch, _ = prepare(spec(colour=colour), Frame(pixels))
    np.testing.assert_allclose(batch, np.full((1, 1, 12, 16), expected), rtol=1e-6)


def finish(form: OutputSpec, raw: np.ndarray, place: Layout, width: int, height: int) -> np.ndarray:
    """Depth at an image's size, without a look at the image."""
    frame = Frame(np.zeros((height, width), np.uint8))
    return full_size(form, coarse_depth(form, raw, place), frame, Upsampling.BILINEAR)


@pytest.mark.parametrize("upsampling", list(Upsampling))
def test_no_depth_is_0_m(upsampling: Upsampling) -> None:
    form = OutputSpec(DepthKind.METRIC, Transform.LINEAR, 1.0, 0.0, min_m=0.0, max_m=10.0)
    raw = np.float32([[-1, -1, 2, 2], [-1, -1, 2, 2]])
    depth = full_size(form, raw, Frame(np.zeros((4, 8), np.uint8)), upsampling)
    assert np.isnan(depth[:, 0]).all()
    assert (depth[:, -1] == 2).all()
    assert np.nanmin(depth) > 0


@given(
    st.integers(1, 5000), st.integers(1, 5000), st.sampled_from([1, 8, 32]), st.sampled_from(Fit)
)
def test_a_dynamic_size_is_a_multiple(width: int, height: int, step: int, fit: Fit) -> None:
    dynamic = spec(width=160, height=128, multiple_of=step, fit=fit)
    place = input_layout(dynamic, width, height)
    assert place.width % step == place.height % step == 0
    assert min(place.width, place.height) > 0
    longer = max(width, height) > 2 * min(width, height)
    assert not place.is_padded or (longer and fit is Fit.KEEP_ASPECT)


@pytest.mark.parametrize(
    ("changes", "image", "expected"),
    [
        ({"dynamic": False}, (40, 10), (16, 12, 0, 3, 16, 6)),
        ({"dynamic": False}, (10, 40), (16, 12, 7, 0, 2, 12)),
        ({"dynamic": False}, (1000, 1), (16, 12, 0, 5, 16, 1)),
        ({"dynamic": False}, (1, 1000), (16, 12, 7, 0, 1, 12)),
        ({}, (300, 200), (14, 14, 0, 0, 14, 14)),  # 192 pixels of 3:2 in all
        ({}, (300, 100), (20, 10, 0, 0, 20, 10)),
        ({"width": 48}, (450, 100), (42, 14, 0, 0, 42, 14)),
        ({"width": 12, "height": 48}, (50, 100), (14, 42, 0, 0, 14, 42)),
        # From here on longer than the network takes, and what half its size has begins with a pixel
        ({}, (1000, 1), (20, 10, 0, 4, 20, 2)),
        ({}, (1, 1000), (10, 20, 4, 0, 2, 20)),
        ({"width": 18}, (1000, 1), (21, 10, 0, 4, 21, 1)),  # it has no half
        ({"multiple_of": 4, "width": 192, "height": 144}, (4000, 500), (236, 116, 0, 36, 236, 44)),
    ],
)
def test_a_letterbox_is_as_large_as_pixels_of_three_to_two_let_it_be(
    changes: dict[str, Any], image: tuple[int, int], expected: tuple[int, ...]
) -> None:
    keeping = spec(fit=Fit.KEEP_ASPECT, pixel_aspect=1.5, **changes)
    assert input_layout(keeping, *image) == expected


def test_a_letterbox_repeats_the_edges() -> None:
    pixels = np.zeros((10, 40), np.uint8)
    pixels[:5] = 255
    batch, place = prepare(spec(dynamic=False, fit=Fit.KEEP_ASPECT), Frame(pixels))
    assert place == Layout(16, 12, 0, 4, 16, 4)
    assert (batch[0, 0, :4] == 1).all()
    assert (batch[0, 0, 8:] == 0).all()


@pytest.mark.parametrize("shape", [(12, 16), (6, 8), (4, 5), (6, 5), (24, 32)])
@pytest.mark.parametrize("left", [2, 3])
def test_a_letterbox_is_cut_off_again(shape: tuple[int, int], left: int) -> None:
    """From an output of half the size, too, whose pixels the image ends with; or enlarged."""
    raw, layout = np.random.default_rng(0).random(shape, np.float32), Layout(16, 12, left, 4, 12, 6)
    expected = resize_bilinear(raw, 16, 12)[4:10, left : left + 12]
    if shape == (6, 8) and left == 2:
        expected = raw[2:5, 1:7]
    np.testing.assert_array_equal(coarse_depth(output(), raw, layout), expected)


@pytest.mark.parametrize(
    ("depth_is", "lacks"), [("above", [True, True, False]), ("below", [False, True, True])]
)
def test_what_is_at_the_threshold_of_a_mask_has_no_depth(
    depth_is: Literal["above", "below"], lacks: list[bool]
) -> None:
    mask = lacks_depth(MaskSpec("sky", 0.5, depth_is), np.float32([0.4, 0.5, 0.6]))
    np.testing.assert_array_equal(mask, lacks)


@pytest.mark.parametrize(
    ("form", "raw", "expected"),
    [
        (output(), [-5, 0.5, 3, 50], [0.5, 0.5, 3, 10]),  # the range of the card
        (output(), [np.nan, 1], [np.nan, 1]),
        (output(transform=Transform.RECIPROCAL), [0, 0, 1], [10, 10, 1]),  # of infinitely far
        (output(DepthKind.RELATIVE, Transform.RECIPROCAL), [0, 1], [np.nan, 1]),
    ],
)
def test_values_in_and_out_of_range(
    form: OutputSpec, raw: list[float], expected: list[float]
) -> None:
    width = len(raw)
    for times in (1, 3):  # resizing has no infinity to spread
        depth = finish(form, np.float32([raw]), Layout(width, 1, 0, 0, width, 1), times * width, 1)
        np.testing.assert_array_equal(depth[:, times // 2 :: times], np.float32([expected]))


def test_decoding_comes_before_resizing() -> None:
    raw = np.float32([[0, 2]])
    depth = finish(output(transform=Transform.EXP), raw, Layout(2, 1, 0, 0, 2, 1), 4, 1)
    low, high = 1, np.exp(2)
    expected = [low, 0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high, high]
    np.testing.assert_allclose(depth[0], expected, rtol=1e-5)


def test_only_metres_above_zero_blend_in_log() -> None:
    metric, relative = output(), output(DepthKind.RELATIVE)
    assert blends_in_log(metric)
    assert not any(map(blends_in_log, (replace(metric, min_m=0.0), relative)))


@pytest.mark.parametrize(
    ("fit", "size", "image", "expected"),
    [
        (Fit.LOWER_BOUND, (16, 12), (16, 12), (20, 15)),  # rounding would cross the bound
        (Fit.UPPER_BOUND, (18, 13), (18, 13), (15, 10)),
        (Fit.UPPER_BOUND, (20, 15), (18, 15), (20, 15)),
        (Fit.MINIMAL, (160, 120), (320, 120), (320, 120)),
        (Fit.MINIMAL, (160, 120), (160, 90), (160, 90)),
        (Fit.LONGEST_SIDE, (100, 100), (50, 24), (100, 50)),
        (Fit.LONGEST_SIDE, (100, 100), (47, 100), (45, 100)),
        (Fit.LOWER_BOUND, (15, 15), (16, 1), (240, 15)),  # 16 times the nominal pixels
        (Fit.LOWER_BOUND, (15, 15), (20, 1), (270, 15)),
        (Fit.LOWER_BOUND, (2000, 2000), (10, 1), (12955, 1295)),  # 2^24 pixels
        (Fit.OWN_SIZE, (16, 12), (18, 14), (15, 10)),
        (Fit.OWN_SIZE, (16, 12), (5000, 4000), (4575, 3660)),
    ],
)
def test_sizes_without_padding(
    fit: Fit, size: tuple[int, int], image: tuple[int, int], expected: tuple[int, int]
) -> None:
    width, height = size
    layout = input_layout(spec(width=width, height=height, multiple_of=5, fit=fit), *image)
    assert layout == Layout(*expected, 0, 0, *expected)


def test_known_depth_is_the_mean_logarithm_of_each_pixel_of_the_layout() -> None:
    """As a plain loop has it; points outside of the file's pixels do not count."""
    random, layout = np.random.default_rng(0), Layout(16, 12, 1, 2, 14, 8)
    x = [*random.integers(0, 40, 60), 0, 39, 40, -1, 5, 5]
    y = [*random.integers(0, 30, 60), 0, 29, 5, 5, 30, -1]
    points = KnownDepth(np.array(x), np.array(y), random.uniform(1, 9, 66))
    cells: dict[tuple[int, int], list[float]] = {}
    for column, row, depth_m in zip(x[:-4], y[:-4], points.depth_m, strict=False):
        cell = 2 + int((row + 0.5) * 8 / 30), 1 + int((column + 0.5) * 14 / 40)
        cells.setdefault(cell, []).append(math.log(depth_m))
    log_m, has_depth = _on_grid_of(points, Frame(np.zeros((30, 40), np.uint8)), layout)
    for cell in np.ndindex(12, 16):
        assert has_depth[cell] == (cell in cells)
        logs = cells.get(cell, [0.0])
        assert log_m[cell] == pytest.approx(sum(logs) / len(logs))
