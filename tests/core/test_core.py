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

from depthcli.core import options
from depthcli.core.camera import (
    UNKNOWN_CAMERA,
    CameraScale,
    Distortion,
    Intrinsics,
)
from depthcli.core.imageops import value_channel
from depthcli.core.options import AUTO_TILE, DepthMask, Upsampling, UpsamplingOptions
from depthcli.core.types import (
    DepthCodec,
    DepthKind,
    DepthMap,
    Frame,
    Provenance,
    Transform,
)
from depthcli.core.validation import fingerprint
from depthcli.errors import InputError, UsageError


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


@pytest.mark.parametrize(
    "given",
    [
        *((focal_px, None) for focal_px in (-400, 0, math.nan, math.inf)),
        *((None, hfov_deg) for hfov_deg in (180, -60, 0.09, 179.91)),
        (400, 60),
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
    for wrong in ({"upsampling": "cubic"}, {"mask": "sky"}):
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
    expected = "8db22fa8cde29a20960eb9abef8603bd68bcd8d9e90bfe70304f510555dddca3"
    assert fingerprint(*facts) == expected


def test_other_facts_give_another_fingerprint_and_another_order_none() -> None:
    others = [Options(1.0), Options(), (Options(0.5),), None, 0.5, "0.5", {"near": 0.5}]
    assert fingerprint(Options(0.5)) not in map(fingerprint, [*others, Upsampling.BILINEAR])
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    with pytest.raises(TypeError):
        fingerprint([object()])
