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

from depthcli.core import camera, options
from depthcli.core.camera import (
    UNKNOWN_CAMERA,
    CameraScale,
    Distortion,
    Intrinsics,
    focal_px_of_crop,
    focal_px_of_hfov,
    hfov_deg,
)
from depthcli.core.imageops import brightness, luma, rgb, transfer_warning, value_channel
from depthcli.core.options import AUTO_TILE, DepthMask, Upsampling, UpsamplingOptions
from depthcli.core.types import (
    DepthCodec,
    DepthKind,
    DepthMap,
    DepthRange,
    Frame,
    Provenance,
    Transform,
    doubt_of_metres,
)
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, UsageError


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_pixels_of_every_type_have_the_same_brightness_and_colours(dtype: type) -> None:
    top = 1 if dtype is np.float32 else np.iinfo(dtype).max
    levels = np.random.default_rng(3).integers(0, 256, (4, 5, 3))
    pixels, shares = (levels * (top / 255)).astype(dtype), levels / 255
    assert value_channel(pixels) == pytest.approx(shares.max(2), abs=1e-6)
    assert luma(pixels) == pytest.approx(shares @ [0.299, 0.587, 0.114], abs=1e-6)
    assert brightness(pixels) == pytest.approx(luma(pixels), abs=0.51 / 255)
    assert rgb(pixels) == pytest.approx(shares, abs=1e-6)
    transparent, repeated = levels[..., 0] > 128, np.dstack([levels[..., 0]] * 3)
    for image, expected in ((pixels, levels), (pixels[..., 0], repeated)):
        frame = Frame(image, transparent=transparent)
        np.testing.assert_array_equal(frame.pixels_8bit(), expected)
        black = np.where(transparent[..., None], 0, expected)
        np.testing.assert_array_equal(frame.pixels_8bit(is_filled=False), black)
        np.testing.assert_array_equal(Frame(image).pixels_8bit(is_filled=False), expected)
    for gray in (value_channel, luma, brightness):
        assert gray(pixels[..., 0]) == pytest.approx(shares[..., 0], abs=1e-6)
    assert rgb(pixels[..., 0]) == pytest.approx(repeated / 255, abs=1e-6)


def test_float_pixels_are_kept_within_zero_and_one() -> None:
    pixels = np.float32([[-0.5, 0.25, 0.5, 1.5]])
    assert value_channel(pixels).tolist() == [[0, 0.25, 0.5, 1]]
    assert Frame(pixels.clip(0)).pixels_8bit()[0, :, 0].tolist() == [0, 64, 128, 255]


def test_colours_of_high_dynamic_range_are_told() -> None:
    warnings = [transfer_warning(code, "image", "sRGB") or "" for code in (1, 16, 17, 18)]
    names = [re.findall(r"\((\w+)\).*image to sRGB", text) for text in warnings]
    assert names == [[], ["PQ"], [], ["HLG"]]


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
        decoded = codec.decode(np.float32([*raw, math.nan]))
        scaled = codec.times(1.03).decode(np.float32(raw))
    assert decoded.tolist() == pytest.approx([*expected, math.nan], rel=1e-6, nan_ok=True)
    assert scaled.tolist() == pytest.approx([1.03 * value for value in expected], rel=1e-6)
    with np.errstate(all="raise"):
        assert DepthCodec(Transform.EXP).decode(np.float32([89, 1])) == pytest.approx(
            [math.inf, math.e]
        )
        assert DepthCodec(Transform.RECIPROCAL).decode(np.float32([1e-39, 0, 2])).tolist() == [
            math.inf,
            math.inf,
            0.5,
        ]
    assert DepthCodec.log_m(0.4, 10).decode(np.float32([-1, 0, 1])) == pytest.approx([0.4, 2, 10])


NAMES = vars(camera) | vars(options)
RULES = [name for name, value in NAMES.items() if isinstance(value, options.Rule)]


@pytest.mark.parametrize("name", RULES)
def test_numbers_end_where_the_message_says(name: str) -> None:
    rule = NAMES[name]
    low, high = map(float, re.findall(r"-?\d[\d.e]*", rule.what))
    for end, sign in ((low, -1), (high, 1)):
        step = 1 if "whole" in rule.what else 1e-6 * max(1, abs(end))
        assert rule.holds(end)
        assert not rule.holds(end + sign * step)


@pytest.mark.parametrize(
    ("of", "focal_px"),  # in an image of 360 x 240 pixels, of the shape of a film
    [
        (Intrinsics.given(0.5, None, (7, 8)), 0.5),
        (Intrinsics(500, 90, focal_35mm=36), 180),
        (Intrinsics(focal_35mm=36), 360),
        (Intrinsics(focal_35mm=36, pixel_aspect=2), 18 * math.hypot(720, 240) / math.hypot(36, 24)),
        (Intrinsics(pixel_aspect=2), None),
    ],
)
def test_a_focal_length_is_in_pixels_of_the_image(of: Intrinsics, focal_px: float | None) -> None:
    assert of.focal_for(360, 240) == (focal_px and pytest.approx(focal_px))
    assert of.has_focal == (focal_px is not None)
    assert of.centre_px in (None, (7, 8))
    if focal_px:
        assert focal_px_of_hfov(hfov_deg(focal_px, 360), 360) == pytest.approx(focal_px)


def test_a_crop_has_the_focal_length_of_the_image_that_it_is_of() -> None:
    for size in ((320, 240), (240, 320), (100, 320), (240, 260)):
        assert focal_px_of_crop(500, (640, 480), size) == pytest.approx(250)


def test_camera_of_one_image_keeps_all_of_the_common_one_but_its_focal_length() -> None:
    scale = CameraScale("a", "m", "", 2.0, 0.0, None, 1, 1)
    common = replace(CALIBRATED, scale=scale)
    assert common.of_image(None) is common
    assert common.of_image(Intrinsics(5.0)) == replace(common, focal_px=5.0)
    its = Intrinsics(5.0, centre_px=(1.0, 2.0), pixel_aspect=1.1)
    assert common.of_image(its) == replace(its, scale=scale)


@pytest.mark.parametrize(
    "arguments",
    [
        *((focal_px, None) for focal_px in (-400, 0, math.nan, math.inf)),
        *((None, hfov_deg) for hfov_deg in (180, -60)),
        (400, 60),
    ],
)
def test_impossible_camera_is_refused(arguments: tuple[Any, ...]) -> None:
    with pytest.raises(UsageError):
        Intrinsics.given(*arguments)


def test_impossible_scale_of_a_camera_is_refused() -> None:
    CameraScale("a", "m", "", 1e-3, -1.0, None, 1, 1)
    for wrong in ((0, 0), (-1, 0), (math.inf, 0), (1, math.nan)):
        with pytest.raises(UsageError):
            CameraScale("a", "m", "", *wrong, None, 1, 1)


CALIBRATED = Intrinsics(400.0, None, (319.5, 200.0), (640, 480), 1.0)


def test_principal_point_is_resized_with_its_image() -> None:
    half_x, half_y = (319.5 + 0.5) / 2 - 0.5, (200 + 0.5) / 2 - 0.5
    for size in ((320, 240), (321, 240), (321, 241)):  # one side may be rounded
        centre_px = CALIBRATED.centre_for(*size)
        assert centre_px == pytest.approx((half_x, half_y), rel=0.004)
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


@pytest.mark.parametrize(
    ("what", "text"),
    [
        (Frame(np.zeros((4, 5), np.uint8), Path("b.png")), "<Frame 5×4, gray uint8, b.png>"),
        (Frame(np.zeros((4, 5, 3), np.float32)), "<Frame 5×4, RGB float32>"),
        (DepthMap(DEPTH_M, DepthKind.INVERSE), "<DepthMap 4×3, inverse, 0.5 to 9>"),
        (
            DepthMap(DEPTH_M, provenance=Provenance("nyu")),
            "<DepthMap 4×3, metric, 0.5 to 9 m, nyu>",
        ),
        (DepthMap(np.full((2, 2), np.nan, np.float32)), "<DepthMap 2×2, metric, no depth>"),
    ],
)
def test_images_and_maps_are_one_short_line_at_a_prompt(what: Frame | DepthMap, text: str) -> None:
    assert repr(what) == text


def test_a_range_is_of_what_has_depth() -> None:
    depth_m = np.float32([[np.nan, 3, 1], [np.inf, 2, 8], [0, -1, np.nan]])
    assert DepthRange.of(DepthMap(depth_m)) == (1, 2.5, 8)
    assert DepthRange.of(DepthMap(depth_m, DepthKind.INVERSE)) == (-1, 1.5, 8)
    assert DepthRange.of(DepthMap(depth_m[:, 1:], DepthKind.RELATIVE)) == (-1, 2, 8)
    assert DepthRange.of(DepthMap(depth_m[:, :1])) == (None, None, None)
    doubts = [bool(doubt_of_metres(median_m)) for median_m in (0.049, 0.05, 100, 101)]
    assert doubts == [True, False, False, True]


def test_choices_are_plain_words_too_and_others_are_refused() -> None:
    chosen = UpsamplingOptions("bilinear", AUTO_TILE, "model")
    assert chosen == UpsamplingOptions(Upsampling.BILINEAR, 0, DepthMask.MODEL)
    assert (type(chosen.upsampling), type(chosen.mask)) == (Upsampling, DepthMask)
    for wrong in ({"upsampling": "cubic"}, {"mask": "sky"}):
        with pytest.raises(UsageError):
            UpsamplingOptions(**wrong)
    with pytest.raises(UsageError):
        Frame(np.zeros((4, 8), np.uint8), projection="fisheye")
    options.check_pixel_count("a.png", 3, 4, 12)
    with pytest.raises(InputError):
        options.check_pixel_count("a.png", 3, 4, 11)


ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", [name for name in vars(options) if name.startswith("INSTALL_")])
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
    expected = "8db22fa8cde29a20960eb9abef8603bd68bcd8d9e90bfe70304f510555dddca3"
    assert fingerprint(*facts) == expected


def test_other_facts_give_another_fingerprint_and_another_order_none() -> None:
    others = [Options(1.0), Options(), (Options(0.5),), None, 0.5, "0.5", {"near": 0.5}]
    assert fingerprint(Options(0.5)) not in map(fingerprint, [*others, Upsampling.BILINEAR])
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    with pytest.raises(TypeError):
        fingerprint([object()])
