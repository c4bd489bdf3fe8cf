"""Windows of frames, panoramas, pixels without depth, and what maps state, against plain loops."""

import math
from dataclasses import replace
from fractions import Fraction

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from depthcli.core.camera import CameraSource, Intrinsics
from depthcli.core.imageops import (
    filled_nearest,
    resize_area,
    resize_area_or_cubic,
    resize_bilinear,
)
from depthcli.core.options import one_line, short_repr
from depthcli.core.types import (
    DepthKind,
    DepthMap,
    Frame,
    Provenance,
    Window,
    Windows,
    displayed_depth,
    displayed_frame,
    masked_to_data_window,
    over_window,
    panorama_rays,
    pixel_aspect_of,
    seen_frame,
    with_camera,
)
from depthcli.errors import InputError

SIDES = st.integers(-3, 5)
WINDOWS = st.builds(Window, SIDES, SIDES, SIDES, SIDES)
BEFORE, AFTER = st.integers(-3, 0), st.integers(1, 4)
AROUND = st.builds(Window, BEFORE, BEFORE, AFTER, AFTER)


def pixels(window: Window) -> set[tuple[int, int]]:
    """Column and row of each pixel."""
    rows = range(window.top, window.bottom)
    return {(x, y) for x in range(window.left, window.right) for y in rows}


def numbered(window: Window, data: Window, target: Window) -> np.ndarray:
    """A number for each pixel of a window that has data; (H, W) float32 over a target window."""
    values = np.full((target.height, target.width), np.nan, np.float32)
    for x, y in pixels(window) & pixels(data) & pixels(target):
        values[y - target.top, x - target.left] = 100 + 10 * x + y
    return values


@given(WINDOWS, WINDOWS, SIDES, SIDES)
def test_windows_are_sets_of_pixels(box: Window, other: Window, columns: int, rows: int) -> None:
    assert len(pixels(box)) == box.width * box.height
    assert box.is_empty == (not pixels(box))
    assert pixels(box.intersection(other)) == pixels(box) & pixels(other)
    assert pixels(box.moved(columns, rows)) == {(x + columns, y + rows) for x, y in pixels(box)}
    if not box.is_empty and not other.is_empty:
        x, y = zip(*(pixels(box) | pixels(other)), strict=True)
        assert box.union(other) == (min(x), min(y), max(x) + 1, max(y) + 1)


@given(AROUND, AROUND, AROUND)
def test_values_of_a_window_are_those_of_its_pixels(
    display: Window, other: Window, data: Window
) -> None:
    same, whole = np.testing.assert_array_equal, display.union(other)
    values, windows = numbered(whole, whole, whole), Windows(whole, data, display)
    for target in (data, Window(9, 9, 11, 12)):
        crop = over_window(numbered(other, other, other), other, target)
        same(crop, numbered(other, other, target))
    depth = DepthMap(values, DepthKind.RELATIVE, error=-values)
    same(masked_to_data_window(depth, windows).values, numbered(whole, data, whole))
    displayed = displayed_depth(depth, windows)
    same((displayed.values, -displayed.error), [numbered(whole, whole, display)] * 2)
    frame = Frame(values.astype(np.uint8), windows=windows)
    assert frame.display_size_px == (display.width, display.height)
    visible = display.union(windows.valid)
    for cut, part in ((displayed_frame(frame), display), (seen_frame(frame), visible)):
        same(cut.pixels, numbered(whole, whole, part))
        assert cut.windows == Windows(part, data, display)
    for unchanged in (Frame(frame.pixels), displayed_frame(frame)):
        assert displayed_frame(unchanged) is unchanged
    assert displayed_depth(depth, None) is masked_to_data_window(depth, None) is depth


@pytest.mark.parametrize("rows", [slice(None), slice(2, 5)])
def test_rays_of_a_panorama_are_those_of_a_plain_loop(rows: slice) -> None:
    expected = []
    for row in range(6)[rows]:
        down = ((row + 0.5) / 6 - 0.5) * math.pi
        rights = [((column + 0.5) / 12 - 0.5) * 2 * math.pi for column in range(12)]
        across = math.cos(down)
        expected.append(
            [(across * math.sin(r), math.sin(down), across * math.cos(r)) for r in rights]
        )
    np.testing.assert_allclose(panorama_rays(12, 6, rows), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("ratio", "is_turned", "aspect"),
    [
        *(
            (None, False, 1),
            (Fraction(0), False, 1),
            (Fraction(2), False, 2),
            (Fraction(2), True, 0.5),
        ),
        *((Fraction(1000), False, 1000), (Fraction(1001), False, 1), (Fraction(1, 1001), False, 1)),
        (Fraction(1, 999), True, 999),
    ],
)
def test_pixel_aspect_is_that_of_the_upright_image(
    ratio: Fraction | None, is_turned: bool, aspect: float
) -> None:
    assert pixel_aspect_of(ratio, is_turned=is_turned) == aspect


@pytest.mark.parametrize(
    ("values", "is_refused"),
    [
        *(([-0.5] * n + [0.5] * (20 - n), n > 2) for n in (2, 3)),  # mostly in another range
        *(([-0.01] * 5 + [0] * 4 + [-0.02], False), ([-0.011] * 10, True)),
        ([1.01] * 5 + [1] * 4 + [1.02], False),
        *(([1.5] * n + [0.5] * (4 - n) + [0] * 6, n > 2) for n in (2, 3)),
        *(([7] * n + [0] * (1000 - n), n > 5) for n in (5, 6)),  # highlights on black
    ],
)
def test_few_pixels_may_be_outside_of_zero_and_one(values: list[float], is_refused: bool) -> None:
    try:
        Frame(np.float32([values]))
    except InputError:
        assert is_refused
    else:
        assert not is_refused


def test_map_states_what_of_its_camera_is_given() -> None:
    source = Provenance("m", focal_px=3.0, is_cropped=True, camera_source=CameraSource.EXIF)
    depth = DepthMap(np.ones((6, 8), np.float32), provenance=source)
    assert with_camera(depth, Intrinsics()) is depth
    provenance = with_camera(depth, Intrinsics(centre_px=(1.0, 2.0), pixel_aspect=2.0)).provenance
    assert provenance == replace(source, centre_px=(1.0, 2.0), pixel_aspect=2.0)
    provenance = with_camera(depth, Intrinsics(hfov_deg=90)).provenance
    option = CameraSource.OPTION
    expected = replace(source, focal_px=pytest.approx(4), is_cropped=False, camera_source=option)
    assert provenance == expected
    bare = DepthMap(depth.values)
    assert with_camera(bare, Intrinsics(5.0)).provenance == Provenance(
        focal_px=5.0, camera_source=option
    )
    assert (depth.unit, DepthMap(depth.values, DepthKind.INVERSE).unit) == ("m", None)
    assert DepthMap(depth.values, "inverse").kind is DepthKind.INVERSE
    for wrong in (depth.values.astype(float), depth.values[0]):
        with pytest.raises(ValueError, match="float32"):
            DepthMap(wrong)


def test_missing_values_are_those_of_the_nearest_pixel() -> None:
    random = np.random.default_rng(0)
    values = random.random((20, 30), np.float32)
    valid = random.random((20, 30)) < np.linspace(0, 0.7, 30) ** 2  # ever more of them touch
    filled, places = filled_nearest(values, valid), np.argwhere(valid)
    for place in np.ndindex(20, 30):
        apart = np.hypot(*(places - place).T)
        near = {values[tuple(pixel)] for pixel in places[apart <= 1.1 * apart.min()]}
        assert filled[place] in near
    assert filled_nearest(values, np.ones_like(valid)) is values


def test_area_or_cubic_is_area_where_both_sides_shrink() -> None:
    values = np.random.default_rng(0).random((6, 8, 3), np.float32)
    for size in ((8, 6), (4, 6), (8, 3), (9, 6), (8, 7), (4, 7), (16, 12)):
        kind = cv2.INTER_AREA if size[0] <= 8 and size[1] <= 6 else cv2.INTER_CUBIC
        expected = cv2.resize(values, size, interpolation=kind)
        np.testing.assert_array_equal(resize_area_or_cubic(values, *size), expected)
    assert resize_area(values, 8, 6) is resize_bilinear(values, 8, 6) is values


def test_text_of_strangers_is_short_and_printable() -> None:
    assert one_line("a\x1b[2J\n\u202eé") == "a\\x1b[2J\\n\\u202eé"
    assert short_repr("é") == "'\\xe9'"
    assert [len(short_repr("a" * n)) for n in (58, 59)] == [60, 63]
