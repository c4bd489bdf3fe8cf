"""Pictures and depth maps as values: what they refuse, and how NumPy and a prompt see them."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest

from depthcli.core.types import DepthKind, DepthMap, DepthRange, Frame, Provenance
from depthcli.errors import InputError

DEPTH_M = np.linspace(0.5, 9, 12, dtype=np.float32).reshape(3, 4)


@pytest.mark.parametrize(
    ("pixels", "problem"),
    [
        (np.zeros((4, 5)), "uint8, uint16 or float32, not float64"),
        (np.zeros((4, 5), np.int64), "not int64"),
        (np.zeros((4, 5), bool), "not bool"),
        (np.zeros((3, 4, 5), np.uint8), "channels first"),
        (np.zeros((1, 4, 5), np.uint8), "channels first"),
        (np.zeros((4, 5, 4), np.uint8), "not a picture"),
        (np.zeros((6, 5, 2), np.uint8), "not a picture"),
        (np.zeros((2, 4, 5, 3), np.uint8), "not a picture"),
        (np.zeros(5, np.uint8), "not a picture"),
        (np.zeros((0, 5), np.uint8), "empty"),
        (np.full((4, 5, 3), 128, np.float32), "not 128 to 128"),
        (np.full((4, 5, 3), -1.5, np.float32), "not -1.5"),
        (np.full((4, 5), np.nan, np.float32), "NaN or infinite"),
        (np.full((4, 5), np.inf, np.float32), "NaN or infinite"),
        (np.float32([[0.5, np.inf, 0.5, 0.5]]), "NaN or infinite"),
    ],
)
def test_invalid_image_is_refused_in_one_line(pixels: np.ndarray, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as caught:
        Frame(pixels)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 3), (3, 5), (1, 1), (3, 3, 3)])
def test_pictures_of_each_type_are_taken(shape: tuple[int, ...], dtype: type) -> None:
    assert Frame(np.ones(shape, dtype)).height == shape[0]


def test_highlights_may_pass_one() -> None:
    pixels = np.full((4, 5), 0.5, np.float32)
    pixels[0] = 7
    assert Frame(pixels).width == 5


def test_highlights_and_negative_light_are_shown_as_white_and_black() -> None:
    pixels = np.full((6, 2), 0.5, np.float32)
    pixels[0] = 1.2, -0.2
    expected = np.full((6, 2), 128)
    expected[0] = 255, 0
    np.testing.assert_array_equal(Frame(pixels).pixels_8bit()[..., 0], expected)


@pytest.mark.parametrize(
    "pixels",
    [
        np.float32([[0, 0, 0, 0], [0, 0, 40, 200]]),  # 0-255, mostly masked
        np.float32([[-1, 0.2], [0.4, 0.9]]),  # [-1, 1]
        np.float32([[-2, 1.5], [-0.1, 0.3]]),  # mean 0, variance 1
    ],
)
def test_floats_in_another_range_are_refused(pixels: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"have to be in \[0, 1\]"):
        Frame(pixels)


@pytest.mark.parametrize("highlight", [np.nextafter(np.float32(1), np.float32(2)), 1.2])
@pytest.mark.parametrize("share", [1, 40])
def test_a_few_highlights_on_black_are_a_picture(highlight: float, share: int) -> None:
    pixels = np.zeros((100, 100), np.float32)
    pixels[: share if highlight < 1.01 else 1, :40] = highlight
    assert Frame(pixels).width == 100


@pytest.mark.parametrize("aspect", [0.0, -1.0, math.nan, math.inf])
def test_a_pixel_has_a_width_and_a_height(aspect: float) -> None:
    with pytest.raises(InputError, match="pixel aspect of"):
        Frame(np.zeros((2, 2), np.uint8), pixel_aspect=aspect)


@pytest.mark.parametrize("kind", DepthKind)
def test_the_kind_of_a_map_may_be_text(kind: DepthKind) -> None:
    depth = DepthMap(np.ones((2, 2), np.float32), str(kind))  # type: ignore[arg-type]
    assert depth.kind is kind
    assert depth.is_metric == (kind is DepthKind.METRIC)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_people_see_eight_bits_and_three_channels(dtype: type) -> None:
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    gray, colour = np.full((4, 5), top, dtype), np.full((4, 5, 3), top, dtype)
    for pixels in (gray, colour):
        np.testing.assert_array_equal(Frame(pixels).pixels_8bit(), np.full((4, 5, 3), 255))


@pytest.mark.parametrize("values", [np.zeros((4, 5)), np.zeros((4, 5, 1), np.float32)])
def test_other_arrays_are_no_depth_map(values: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"depth is \(H, W\) float32, not "):
        DepthMap(values)


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


def test_numpy_gets_a_copy_or_another_type_on_request() -> None:
    depth = DepthMap(DEPTH_M)
    assert not np.shares_memory(np.array(depth), DEPTH_M)
    assert np.asarray(depth, np.float64).dtype == np.float64
    if np.lib.NumpyVersion(np.__version__) >= "2.0.0":
        assert np.shares_memory(np.array(depth, copy=False), DEPTH_M)
        with pytest.raises(ValueError, match="copy"):
            np.array(depth, np.float64, copy=False)


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


@pytest.mark.parametrize("value", [DepthMap(DEPTH_M), Frame(np.zeros((2, 3), np.uint8))])
def test_maps_and_pictures_are_compared_by_identity(value: DepthMap | Frame) -> None:
    assert value == value  # noqa: PLR0124 - arrays in it must not be compared
    assert value != copy.copy(value)
    assert len({value, copy.copy(value)}) == 2


def test_a_map_goes_to_another_process() -> None:
    sent = DepthMap(DEPTH_M, DepthKind.RELATIVE, Provenance("nyu", focal_px=500.0))
    received = pickle.loads(pickle.dumps(sent))  # noqa: S301 - our own bytes
    np.testing.assert_array_equal(received.values, DEPTH_M)
    assert (received.kind, received.provenance) == (sent.kind, sent.provenance)


@pytest.mark.parametrize("count", range(1, 6))
def test_the_range_has_the_median_of_what_is_finite(count: int) -> None:
    values = np.float32([[*[5, 1, 9, 2, 7][:count], np.nan, np.inf]])
    found = DepthRange.of(DepthMap(values))
    finite = values[0, :count]
    assert (found.min, found.median, found.max) == (finite.min(), np.median(finite), finite.max())
