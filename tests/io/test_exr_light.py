"""What is said of EXR pictures that lose light or colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import OpenEXR
import pytest

from depthcli.core.options import ReadOptions
from depthcli.errors import UsageError
from depthcli.io.exr.image import primaries_matrix, read_exr_image
from depthcli.io.images.read import read_image

if TYPE_CHECKING:
    from pathlib import Path

REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
REC_601 = (0.63, 0.34, 0.31, 0.595, 0.155, 0.07, 0.3127, 0.3290)
REC_2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
ACESCG = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
P3_D65 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290)
PUBLISHED = {
    REC_2020: [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]],
    ACES: [[2.5217, -1.1341, -0.3876], [-0.2765, 1.3727, -0.0962], [-0.0154, -0.1530, 1.1684]],
    ACESCG: [[1.7051, -0.6218, -0.0833], [-0.1303, 1.1408, -0.0105], [-0.0240, -0.1290, 1.1530]],
    P3_D65: [[1.2249, -0.2249, 0.0], [-0.0421, 1.0421, 0.0], [-0.0196, -0.0786, 1.0983]],
}
"""From these colours to those of Rec. 709, of ITU-R BT.2407, the ACES documents and others."""


def warnings_of(path: Path, *, colours: str = "RGB", share: float = 0, **header: Any) -> list[str]:
    """Those about a picture of which a share of the pixels is above 1, in blue or in Y."""
    light = np.ones((10, 20), np.float32)
    bright = light.copy()
    bright.ravel()[: round(share * light.size)] = 1.5
    header = {"type": OpenEXR.scanlineimage, **header}
    channels = dict.fromkeys(colours, light) | {colours[-1]: bright}
    OpenEXR.File(header, channels).write(str(path))
    return list(read_exr_image(path).warnings)


@pytest.mark.parametrize("colours", ["RGB", "Y"])
def test_many_pixels_above_1_are_told(colours: str, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    assert warnings_of(path, colours=colours) == []
    assert warnings_of(path, colours=colours, share=0.29) == []
    (warning,) = warnings_of(path, colours=colours, share=0.3)
    assert warning.startswith("30%")
    assert read_exr_image(path, options=ReadOptions(exposure=-1)).warnings == ()


def test_the_share_is_that_of_the_pixels_that_the_file_has(tmp_path: Path) -> None:
    wide = {"dataWindow": ((0, 0), (19, 9)), "displayWindow": ((0, 0), (99, 99))}
    (warning,) = warnings_of(tmp_path / "a.exr", share=0.5, **wide)
    assert warning.startswith("50%")
    aside = wide | {"dataWindow": ((200, 0), (219, 9))}
    (warning,) = warnings_of(tmp_path / "a.exr", share=0.5, **aside)
    assert warning.startswith("50%")


@pytest.mark.parametrize("stated", [REC_709, REC_601])
def test_primaries_of_screens_are_silent(stated: tuple[float, ...], tmp_path: Path) -> None:
    assert warnings_of(tmp_path / "a.exr", chromaticities=stated) == []


@pytest.mark.parametrize("stated", PUBLISHED)
def test_colours_become_those_of_rec_709(stated: tuple[float, ...], tmp_path: Path) -> None:
    matrix, problem = primaries_matrix(stated)
    assert problem is None
    assert matrix is not None
    np.testing.assert_allclose(matrix, PUBLISHED[stated], atol=2e-4)
    np.testing.assert_allclose(matrix @ np.ones(3), 1, atol=1e-5)  # white stays white
    light = np.random.default_rng(0).uniform(0, 2, (50, 40, 3)).astype(np.float32)
    light[0, 0] = np.nan, np.inf, 0.5
    header = {"type": OpenEXR.scanlineimage, "chromaticities": stated}
    channels = {colour: light[..., i].copy() for i, colour in enumerate("RGB")}
    OpenEXR.File(header, channels).write(str(tmp_path / "a.exr"))
    pixels = read_exr_image(tmp_path / "a.exr", options=ReadOptions(exposure=-1)).pixels
    assert np.isfinite(pixels).all()
    expected = np.clip(light[1:].astype(np.float64) / 2 @ np.transpose(PUBLISHED[stated]), 0, 1)
    curve = np.where(expected <= 0.0031308, 12.92 * expected, 1.055 * expected ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(pixels[1:], curve, atol=2e-3)


def test_primaries_are_those_of_the_first_part_if_a_part_states_none(tmp_path: Path) -> None:
    light = np.random.default_rng(0).uniform(0, 1, (3, 4, 6)).astype(np.float32)
    colours = dict(zip("RGB", light, strict=True))
    first = {"type": OpenEXR.scanlineimage, "chromaticities": ACESCG}
    parts = [
        OpenEXR.Part(first, {"Z": light[0]}, "depth"),
        OpenEXR.Part({"type": OpenEXR.scanlineimage}, colours, "rgba"),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    OpenEXR.File(first, colours).write(str(tmp_path / "one.exr"))
    found, wanted = (read_exr_image(tmp_path / f"{name}.exr").pixels for name in ("parts", "one"))
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(
    "stated",
    [
        (float("nan"), *ACES[1:]),
        (*ACES[:7], 0.0),
        (0.0,) * 8,
        (0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3),
    ],
)
def test_primaries_that_are_none_are_told(stated: tuple[float, ...], tmp_path: Path) -> None:
    (warning,) = warnings_of(tmp_path / "a.exr", chromaticities=stated)
    assert "primaries" in warning
    assert warnings_of(tmp_path / "a.exr", colours="Y", chromaticities=stated) == []


@pytest.mark.parametrize("stops", [-2.0, 0.5, 3])
def test_exposure_is_in_stops_of_light(stops: float, tmp_path: Path) -> None:
    light = np.geomspace(1e-3, 4, 200, dtype=np.float32).reshape(10, 20)
    path, brighter = tmp_path / "a.exr", tmp_path / "b.exr"
    for file, factor in ((path, 1.0), (brighter, 2**stops)):
        header = {"type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Y": light * np.float32(factor)}).write(str(file))
    wanted = read_exr_image(brighter).pixels
    np.testing.assert_allclose(read_image(path, exposure=stops).pixels, wanted, atol=1e-6)
    for stopped in (21, float("nan")):
        with pytest.raises(UsageError, match="-20 to 20"):
            read_image(path, exposure=stopped)


def test_primaries_of_another_type_count_as_not_stated(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    warnings_of(path, chromaticitie_="Rec. 2020")
    path.write_bytes(path.read_bytes().replace(b"chromaticitie_\0", b"chromaticities\0"))
    assert read_exr_image(path).warnings == ()
