"""Codecs, types, choices."""

import math
import re
import tomllib
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.core import options
from depthcli.core.camera import (
    UNKNOWN_CAMERA,
    CameraScale,
    Distortion,
    Intrinsics,
    focal_px_of_hfov,
    hfov_deg,
)
from depthcli.core.imageops import luma, resize_area, resize_bilinear, rgb, value_channel
from depthcli.core.options import AUTO_TILE, DepthMask, Upsampling, UpsamplingOptions
from depthcli.core.types import (
    DepthCodec,
    DepthKind,
    DepthMap,
    DepthRange,
    Frame,
    Provenance,
    Transform,
)
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, UsageError

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


FORMULAS = {
    Transform.LINEAR: lambda t: t,
    Transform.EXP: math.exp,
    Transform.RECIPROCAL: lambda t: 1 / t if t > 0 else math.inf,
}


@pytest.mark.parametrize("transform", Transform)
def test_decoding_is_its_formula(transform: Transform) -> None:
    codec, raw = DepthCodec(transform, 0.25, 0.5), [-4, -2, 0, 0.8, 3]  # 0.25 · -2 + 0.5 = 0
    expected = [FORMULAS[transform](0.25 * value + 0.5) for value in raw]
    with np.errstate(all="raise"):
        found = codec.decode(np.float32([*raw, math.nan]))
        scaled = codec.times(1.03).decode(np.float32(raw))
    assert found.tolist() == pytest.approx([*expected, math.nan], rel=1e-6, nan_ok=True)
    assert scaled.tolist() == pytest.approx([1.03 * value for value in expected], rel=1e-6)


def test_codings_put_their_ends_at_minus_one_and_one() -> None:
    """Linear is the paper's."""
    for codec, ends in (
        (DepthCodec(scale=5, shift=5), (0, 10)),
        (DepthCodec.log_m(0.4, 10), (0.4, 10)),
        (DepthCodec(), (-1, 1)),
    ):
        assert codec.decode(np.float32([-1, 1])) == pytest.approx(ends, rel=1e-5)


def test_focal_lengths() -> None:
    assert focal_px_of_hfov(63.3, 640) == pytest.approx(518.86, rel=2e-3)
    assert focal_px_of_hfov(90, 1000) == pytest.approx(500)
    assert Intrinsics(focal_35mm=36).focal_for(360, 240) == pytest.approx(360)
    for camera, at_640 in (
        (Intrinsics(500), 500),
        (Intrinsics(500, 90), 320),
        (Intrinsics(), None),
    ):
        assert camera.focal_for(640, 480) == (at_640 and pytest.approx(at_640))
        assert camera.has_focal == (at_640 is not None)


@pytest.mark.parametrize(
    "given",
    [
        *((focal_px, None) for focal_px in (-400, 0, math.nan, math.inf)),
        *((None, hfov_deg) for hfov_deg in (180, -60, 0.09, 179.91)),
        (400, 60),
        *((None, None, centre_px) for centre_px in ((math.nan, 3), (3, math.inf))),
    ],
)
def test_impossible_camera_is_refused(given: tuple[Any, ...]) -> None:
    with pytest.raises(UsageError):
        Intrinsics.given(*given)


@pytest.mark.parametrize(("scale", "shift_m"), [(0, 0), (-1, 0), (math.inf, 0), (1, math.nan)])
def test_impossible_scale_of_a_camera_is_refused(scale: float, shift_m: float) -> None:
    CameraScale("a", "m", "", 1e-3, -1.0, None, 1, 1)
    with pytest.raises(UsageError):
        CameraScale("a", "m", "", scale, shift_m, None, 1, 1)


CALIBRATED = Intrinsics(400.0, None, (319.5, 200.0), (640, 480), 1.0)


def test_principal_point_is_resized_with_its_image() -> None:
    half_x, half_y = (319.5 + 0.5) / 2 - 0.5, (200 + 0.5) / 2 - 0.5
    for size in ((320, 240), (321, 240), (321, 241)):  # one side may be rounded
        found = CALIBRATED.centre_for(*size)
        assert found == pytest.approx((half_x, half_y), rel=0.004)
    assert CALIBRATED.centre_for(640, 480) == (319.5, 200)
    assert Intrinsics(centre_px=(3.0, 4.0)).centre_for(7, 9) == (3, 4)
    for size in ((640, 360), (480, 640), (322, 240), (320, 241)):
        with pytest.raises(InputError):
            CALIBRATED.centre_for(*size)


def test_doubts_about_a_calibration_are_warnings() -> None:
    lens = Distortion((1, 1), (0.1,))
    assert UNKNOWN_CAMERA.warnings == CALIBRATED.warnings == ()
    for doubt, advice in ({"distortion": lens}, "rectify"), ({"size_px": None}, "do not resize"):
        (warning,) = replace(CALIBRATED, **doubt).warnings
        assert warning.startswith("the ")
        assert advice in warning


def test_camera_of_one_image_keeps_all_of_the_common_one_but_its_focal_length() -> None:
    scale = CameraScale("a", "m", "", 2.0, 0.0, None, 1, 1)
    common = replace(CALIBRATED, scale=scale)
    assert common.of_image(None) is common
    assert common.of_image(Intrinsics(5.0)) == replace(common, focal_px=5.0)
    own = Intrinsics(5.0, centre_px=(1.0, 2.0), pixel_aspect=1.1)
    assert common.of_image(own) == replace(own, scale=scale)


@given(st.floats(0.1, 179.9), st.integers(1, 20_000))
def test_a_field_of_view_is_that_of_its_focal_length(degrees: float, width: int) -> None:
    assert hfov_deg(focal_px_of_hfov(degrees, width), width) == pytest.approx(degrees)


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
    assert DepthRange.of(DepthMap(depth_m[:, :1])) == DepthRange(None, None, None)


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_a_map_without_a_unit_has_depth_wherever_it_is_finite(kind: DepthKind) -> None:
    depth = DepthMap(np.float32([[np.nan, np.inf, 0, -1, 2]]), kind)
    assert depth.valid.tolist() == [[False, False, True, True, True]]
    assert DepthRange.of(depth) == DepthRange(-1, 0, 2)


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


def test_choices_are_plain_words_too_and_others_are_refused() -> None:
    made = UpsamplingOptions("bilinear", AUTO_TILE, "model")
    assert made == UpsamplingOptions(Upsampling.BILINEAR, 0, DepthMask.MODEL)
    assert (type(made.upsampling), type(made.mask)) == (Upsampling, DepthMask)
    for wrong in ({"upsampling": "cubic"}, {"tile_px": -1}, {"mask": "sky"}):
        with pytest.raises(UsageError):
            UpsamplingOptions(**wrong)


ROOT = Path(__file__).parents[2]
HINTS = sorted(name for name in vars(options) if name.startswith("INSTALL_"))


@pytest.mark.parametrize("name", HINTS)
def test_hint_names_an_extra_or_one_package_of_an_extra(name: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    packages = {re.split(r"[<>=;\[]", line)[0] for lines in extras.values() for line in lines}
    what = getattr(options, name).removeprefix("pip install ")
    assert what in {f"'depthcli[{extra}]'" for extra in extras} | packages


def test_hints_need_neither_a_copy_of_the_repository_nor_an_index_that_has_depthcli() -> None:
    """What is installed already satisfies pip, wherever it runs; a page is read before that."""
    code, pages = ROOT.glob("depthcli/**/*.py"), (*ROOT.glob("docs/*.md"), ROOT / "README.md")
    named = [str(path) for path in code if "install '.[" in path.read_text("utf-8")]
    named += [str(path) for path in pages if "install 'depthcli[" in path.read_text("utf-8")]
    assert named == []


@dataclass(frozen=True)
class Options:
    """One option."""

    near_m: float | None = None


def test_it_is_the_same_for_ever() -> None:
    facts = (
        "a",
        Options(0.5),
        UpsamplingOptions(tile_px=3),
        Fraction(1, 3),
        Path("a/b"),
        {"b": 1, "a": [2]},
    )
    expected = "8dfdc48b0ec6b653820a5b64f4010be2619f691c85e98ac879adb232e060c5a2"
    assert fingerprint(*facts) == expected


def test_other_facts_give_another_fingerprint_and_another_order_none() -> None:
    others = [Options(1.0), Options(), (Options(0.5),), None, 0.5, "0.5", {"near": 0.5}]
    assert fingerprint(Options(0.5)) not in map(fingerprint, [*others, Upsampling.BILINEAR])
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    with pytest.raises(TypeError):
        fingerprint([object()])
