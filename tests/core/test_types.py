"""Pictures and depth maps as values: what they refuse, and how NumPy and a prompt see them."""

import math

import numpy as np
import pytest

from depthcli.core.types import DepthKind, DepthMap, DepthRange, Frame, Provenance
from depthcli.errors import InputError

DEPTH_M = np.linspace(0.5, 9, 12, dtype=np.float32).reshape(3, 4)


@pytest.mark.parametrize(
    "pixels",
    [
        *(np.zeros((4, 5), kind) for kind in (np.float64, np.int64, bool)),
        *(np.zeros(shape, np.uint8) for shape in ((3, 4, 5), (1, 4, 5))),  # channels first
        *(np.zeros(shape, np.uint8) for shape in ((4, 5, 4), (6, 5, 2), (2, 4, 5, 3), 5, (0, 5))),
        *(np.full((4, 5), number, np.float32) for number in (128, -1.5, np.nan, np.inf)),
        np.float32([[0.5, np.inf, 0.5, 0.5]]),
    ],
)
def test_invalid_image_is_refused_in_one_line(pixels: np.ndarray) -> None:
    with pytest.raises(InputError) as caught:
        Frame(pixels)
    assert "\n" not in str(caught.value)


def test_highlights_may_pass_one() -> None:
    pixels = np.full((4, 5), 0.5, np.float32)
    pixels[0] = 7
    assert Frame(pixels).width == 5


@pytest.mark.parametrize(
    "pixels",
    [
        np.float32([[0, 0, 0, 0], [0, 0, 40, 200]]),  # 0-255, mostly masked
        np.float32([[-1, 0.2], [0.4, 0.9]]),  # [-1, 1]
        np.float32([[-2, 1.5], [-0.1, 0.3]]),  # mean 0, variance 1
    ],
)
def test_floats_in_another_range_are_refused(pixels: np.ndarray) -> None:
    with pytest.raises(InputError):
        Frame(pixels)


@pytest.mark.parametrize("aspect", [0.0, -1.0, math.nan, math.inf])
def test_a_pixel_has_a_width_and_a_height(aspect: float) -> None:
    with pytest.raises(InputError):
        Frame(np.zeros((2, 2), np.uint8), pixel_aspect=aspect)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_people_see_eight_bits_and_three_channels(dtype: type) -> None:
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    gray, colour = np.full((4, 5), top, dtype), np.full((4, 5, 3), top, dtype)
    for pixels in (gray, colour):
        np.testing.assert_array_equal(Frame(pixels).pixels_8bit(), np.full((4, 5, 3), 255))


def test_a_range_leaves_out_what_has_no_depth() -> None:
    depth_m = np.float32([[np.nan, 3, 1], [np.inf, 2, 8], [0, -1, np.nan]])
    depth = DepthMap(depth_m)
    assert depth.valid.sum() == 4
    assert DepthRange.of(depth) == DepthRange(1, 2.5, 8)
    assert repr(depth) == "<DepthMap 3×3, metric, 1 to 8 m>"
    assert DepthRange.of(DepthMap(depth_m[:, :1])) == DepthRange(None, None, None)


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_a_map_without_a_unit_has_depth_wherever_it_is_finite(kind: DepthKind) -> None:
    depth = DepthMap(np.float32([[np.nan, np.inf, 0, -1, 2]]), kind)
    assert depth.valid.tolist() == [[False, False, True, True, True]]
    assert DepthRange.of(depth) == DepthRange(-1, 0, 2)


def test_a_map_is_its_values_to_numpy() -> None:
    depth = DepthMap(DEPTH_M)
    seen = np.asarray(depth)
    assert (seen.dtype, seen.shape) == (np.float32, (3, 4))
    assert np.shares_memory(seen, DEPTH_M)
    assert float(np.nanmax(depth)) == 9
    np.testing.assert_array_equal(np.add(depth, 1), DEPTH_M + 1)


@pytest.mark.parametrize(
    ("depth", "shown"),
    [
        (DepthMap(DEPTH_M), "<DepthMap 4×3, metric, 0.5 to 9 m>"),
        (DepthMap(DEPTH_M, DepthKind.INVERSE), "<DepthMap 4×3, inverse, 0.5 to 9>"),
        (
            DepthMap(DEPTH_M, provenance=Provenance("nyu")),
            "<DepthMap 4×3, metric, 0.5 to 9 m, nyu>",
        ),
        (DepthMap(np.full((2, 2), np.nan, np.float32)), "<DepthMap 2×2, metric, no depth>"),
    ],
)
def test_a_map_is_one_short_line_at_a_prompt(depth: DepthMap, shown: str) -> None:
    assert repr(depth) == shown


@pytest.mark.parametrize("count", range(1, 6))
def test_the_range_has_the_median_of_what_is_finite(count: int) -> None:
    values = np.float32([[*[5, 1, 9, 2, 7][:count], np.nan, np.inf]])
    found = DepthRange.of(DepthMap(values))
    finite = values[0, :count]
    assert (found.min, found.median, found.max) == (finite.min(), np.median(finite), finite.max())
