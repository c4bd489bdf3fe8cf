"""What the network sees: colour at full precision, size, normalization."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from depthcli.core.options import Upsampling
from depthcli.core.types import DepthKind, Frame, Transform
from depthcli.inference.transforms import (
    Layout,
    _on_grid_of,
    blends_in_log,
    coarse_depth,
    full_size,
    input_layout,
    prepare,
)
from depthcli.known.points import KnownDepth
from depthcli.models.card import Colour, Fit, InputSpec, OutputSpec


def spec(
    *,
    colour: Colour = Colour.VALUE,
    width: int = 16,
    height: int = 12,
    dynamic: bool = True,
    multiple_of: int = 1,
    fit: Fit = Fit.STRETCH,
    mean: tuple[float, ...] = (0.0,),
    std: tuple[float, ...] = (1.0,),
) -> InputSpec:
    return InputSpec(colour, width, height, dynamic, multiple_of, fit, mean, std)


def output(
    kind: DepthKind = DepthKind.METRIC, transform: Transform = Transform.LINEAR
) -> OutputSpec:
    return OutputSpec(kind, transform, 1.0, 0.0, 0.5, 10.0)


def test_value_keeps_sixteen_bits() -> None:
    pixels = np.full((12, 16, 3), 0, np.uint16)
    pixels[..., 1] = 257 * 100 + 1
    batch, _ = prepare(spec(), Frame(pixels))
    np.testing.assert_allclose(batch, (257 * 100 + 1) / 65535, rtol=1e-6)


def test_channels_are_red_green_blue_each_with_its_mean_and_std() -> None:
    pixels = np.broadcast_to(np.uint8([255, 51, 0]), (12, 16, 3))
    rgb = spec(colour=Colour.RGB, mean=(0.5, 0.1, 0.0), std=(0.5, 0.1, 0.2))
    batch, _ = prepare(rgb, Frame(np.ascontiguousarray(pixels)))
    assert batch.shape == (1, 3, 12, 16)
    assert batch.dtype == np.float32
    np.testing.assert_allclose(batch[0, :, 0, 0], [1, 1, 0], atol=1e-6)


def test_luma_is_one_channel_between_the_colours() -> None:
    pixels = np.ascontiguousarray(np.broadcast_to(np.uint8([0, 255, 0]), (12, 16, 3)))
    batch, _ = prepare(spec(colour=Colour.LUMA), Frame(pixels))
    assert batch.shape == (1, 1, 12, 16)
    assert 0.5 < batch[0, 0, 0, 0] < 0.8


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


@pytest.mark.parametrize("size", [(30000, 1), (1, 30000), (4000, 500), (1, 1_000_000)])
def test_a_long_strip_is_padded_to_two_to_one(size: tuple[int, int]) -> None:
    place = input_layout(spec(width=192, height=144, multiple_of=4, fit=Fit.KEEP_ASPECT), *size)
    long, short = (0, 1) if size[0] > size[1] else (1, 0)
    outer, inner = (place.width, place.height), (place.inner_width, place.inner_height)
    assert (outer[long], outer[short]) == (236, 116)
    assert (inner[long], inner[short]) == (236, max(2, 2 * round(118 * size[short] / size[long])))
    assert abs((place.left, place.top)[short] - (116 - inner[short]) / 2) <= 1
    assert all(length % 2 == 0 for length in place)  # an output of half the size has these edges


def test_a_letterbox_repeats_the_edges() -> None:
    pixels = np.zeros((10, 40), np.uint8)
    pixels[:5] = 255
    batch, place = prepare(spec(dynamic=False, fit=Fit.KEEP_ASPECT), Frame(pixels))
    assert place == Layout(16, 12, 0, 4, 16, 4)
    assert (batch[0, 0, :4] == 1).all()
    assert (batch[0, 0, 8:] == 0).all()


@pytest.mark.parametrize("stride", [1, 2])
def test_a_letterbox_is_cut_off_again(stride: int) -> None:
    pixels = np.tile(np.linspace(0, 255, 40).astype(np.uint8), (10, 1))
    batch, place = prepare(spec(dynamic=False, fit=Fit.KEEP_ASPECT), Frame(pixels))
    raw = batch[0, 0].reshape(12 // stride, stride, 16 // stride, stride).mean(axis=(1, 3))
    depth = finish(output(DepthKind.RELATIVE), raw, place, 40, 10)
    assert depth.shape == (10, 40)
    np.testing.assert_allclose(depth[:, 3:-3], pixels[:, 3:-3] / 255, atol=0.03)


@pytest.mark.parametrize(
    ("form", "raw", "expected"),
    [
        (output(), [-5, 0.5, 3, 50], [0.5, 0.5, 3, 10]),  # the range of the card
        (output(), [np.nan, 1], [np.nan, 1]),
        (output(DepthKind.RELATIVE, Transform.RECIPROCAL), [0, 1], [np.nan, 1]),  # infinitely far
    ],
)
def test_values_in_and_out_of_range(
    form: OutputSpec, raw: list[float], expected: list[float]
) -> None:
    width = len(raw)
    depth = finish(form, np.float32([raw]), Layout(width, 1, 0, 0, width, 1), width, 1)
    np.testing.assert_array_equal(depth, np.float32([expected]))


def test_decoding_comes_before_resizing() -> None:
    raw = np.float32([[0, 2]])
    depth = finish(output(transform=Transform.EXP), raw, Layout(2, 1, 0, 0, 2, 1), 4, 1)
    low, high = 1, np.exp(2)
    expected = [low, 0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high, high]
    np.testing.assert_allclose(depth[0], expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("kind", "min_m", "in_log"),
    [
        (DepthKind.METRIC, 0.5, True),
        (DepthKind.METRIC, 0.0, False),
        (DepthKind.RELATIVE, 0.5, False),
        (DepthKind.INVERSE, None, False),
    ],
)
def test_what_is_above_zero_blends_in_log(
    kind: DepthKind, min_m: float | None, in_log: bool
) -> None:
    form = OutputSpec(kind, Transform.LINEAR, 1.0, 0.0, min_m, 10.0)
    assert blends_in_log(form) is in_log


def test_infinitely_far_is_the_largest_depth() -> None:
    raw = np.float32([[0, 1], [0, 1]])
    reciprocal = output(transform=Transform.RECIPROCAL)
    depth = finish(reciprocal, raw, Layout(2, 2, 0, 0, 2, 2), 8, 8)
    assert depth[0, 0] == 10
    assert depth[0, -1] == 1
    assert np.isfinite(depth).all()


@pytest.mark.parametrize(
    ("fit", "size", "image", "seen"),
    [
        (Fit.LOWER_BOUND, (16, 12), (16, 12), (20, 15)),  # rounding would cross the bound
        (Fit.UPPER_BOUND, (18, 13), (18, 13), (15, 10)),
        (Fit.UPPER_BOUND, (20, 15), (18, 15), (20, 15)),
        (Fit.MINIMAL, (160, 120), (320, 120), (320, 120)),
        (Fit.MINIMAL, (160, 120), (160, 90), (160, 90)),
        (Fit.LONGEST_SIDE, (100, 100), (50, 24), (100, 50)),
    ],
)
def test_sizes_without_padding(
    fit: Fit, size: tuple[int, int], image: tuple[int, int], seen: tuple[int, int]
) -> None:
    width, height = size
    found = input_layout(spec(width=width, height=height, multiple_of=5, fit=fit), *image)
    assert found == Layout(*seen, 0, 0, *seen)


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
    log_m, known = _on_grid_of(points, Frame(np.zeros((30, 40), np.uint8)), layout)
    for cell in np.ndindex(12, 16):
        assert known[cell] == (cell in cells)
        logs = cells.get(cell, [0.0])
        assert log_m[cell] == pytest.approx(sum(logs) / len(logs))
