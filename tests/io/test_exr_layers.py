"""Images and depth in EXR: their layers, eyes and light."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from helpers.plates import depth_channel

from depthcli.core.options import ReadOptions
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.exr.file import choose_depth, colour_channels, read_exr_channels
from depthcli.io.exr.image import primaries_matrix, read_exr_image
from depthcli.io.images.read import read_image
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.jobs.convert import ConvertRequest, convert
from depthcli.video.source import open_frames

BLENDER = ("ViewLayer.Emit", "ViewLayer.Combined", "ViewLayer.DiffCol")
GRAY = np.full((4, 6), 0.5, np.float32)


def channels_of(*layers: str) -> list[str]:
    return [f"{layer}.{colour}".removeprefix(".") for layer in layers for colour in "ABGR"]


@pytest.mark.parametrize(
    ("layers", "prefix"),
    [
        (("beauty", ""), ""),
        (BLENDER, "ViewLayer.Combined."),
        (("N", "rgba_main"), "rgba_main."),
        (("normal", "beauty"), "beauty."),
        (("crypto_object00", "world_position", "VRayZDepth", "final"), "final."),
        (("specular", "diffuse"), "diffuse."),
        (("diffuse", "RGBA"), "RGBA."),
        (("N",), "N."),
        (("a.very.long.C", "b"), "a.very.long.C."),
    ],
)
def test_the_image_is_found_by_its_name(layers: tuple[str, ...], prefix: str) -> None:
    expected = tuple(prefix + colour for colour in "RGB"), None
    assert colour_channels("a.exr", channels_of(*layers)) == expected
    assert colour_channels("a.exr", channels_of(*layers[::-1])) == expected


@pytest.mark.parametrize(
    ("layers", "others"),
    [
        (("key", "fill"), "fill"),
        (("fg.Combined", "bg.Combined", "fg.Emit"), "bg.Combined"),
        (("a", "b", "c1", "d", "e", "f", "g", "N"), "b, c1, d, e and 2 others"),
        (("N", "P"), "P"),
    ],
)
def test_of_several_the_first_is_used_with_a_warning(layers: tuple[str, ...], others: str) -> None:
    channels, warning = colour_channels("a.exr", channels_of(*layers))
    assert channels[0] == f"{layers[0]}.R"
    assert f"if it is in {others}, " in warning


def test_luminance_is_an_image_but_no_part_of_a_vector() -> None:
    assert colour_channels("a.exr", ["BY", "RY", "Y", *channels_of("b")]) == (("Y",), None)
    for names in (["X", "Y", "Z"], ["N.X", "N.Y", "N.Z"], ["R", "G", "b.B"]):
        with pytest.raises(InputError, match=r"a\.exr holds no image"):
            colour_channels("a.exr", names)


def test_a_layer_can_be_chosen() -> None:
    names = [*channels_of("", "fg.beauty", "bg.Beauty", "fg.N"), "fg.luma.Y", "P.X", "P.Y"]
    for layer, prefix in (
        ("fg.beauty", "fg.beauty."),
        ("BG.beauty", "bg.Beauty."),
        ("fg.beauty.", "fg.beauty."),
        ("n", "fg.N."),
    ):
        expected = tuple(prefix + colour for colour in "RGB")
        assert colour_channels("a.exr", names, layer) == (expected, None)
    assert colour_channels("a.exr", names, "luma") == (("fg.luma.Y",), None)
    for layer in ("beauty", "depth", "P", ""):  # the first is that of two
        with pytest.raises(InputError, match=f"'{layer}'.*fg.*bg"):
            colour_channels("a.exr", names, layer)


@pytest.mark.parametrize(
    "colours", ["rgb", "RGB", ("red", "green", "blue"), ("Red", "Green", "Blue")]
)
def test_the_notations_of_colours(colours: str | tuple[str, ...]) -> None:
    channels = tuple(colours)
    assert colour_channels("a.exr", sorted(channels)) == (channels, None)
    assert colour_channels("a.exr", sorted([*channels, "Y", "alpha", "a"])) == (channels, None)
    layer = tuple(f"fg.{colour}" for colour in colours)
    names = sorted([*layer, *channels_of("bg"), "N.red", "N.green", "N.blue", "depth.Z"])
    assert colour_channels("a.exr", names, "fg") == (layer, None)
    chosen, warning = colour_channels("a.exr", names)
    assert chosen == ("bg.R", "bg.G", "bg.B")
    assert "bg" in warning
    assert depth_channel(names) == "depth.Z"


@pytest.mark.parametrize("layer", ["rgba", "RGB", "rgba."])
def test_the_layer_without_a_name_can_be_chosen(layer: str) -> None:
    unnamed = (tuple("RGB"), None)
    assert colour_channels("a.exr", channels_of("", "fg"), layer) == unnamed
    assert colour_channels("a.exr", ["Y", "Z"], layer) == (("Y",), None)
    named = layer.strip(".")
    expected = tuple(f"fg.{named}.{colour}" for colour in "RGB"), None
    assert colour_channels("a.exr", channels_of("", f"fg.{named}"), layer) == expected
    with pytest.raises(InputError):
        colour_channels("a.exr", channels_of("fg"), layer)


def test_parts_are_layers_and_the_warning_is_that_of_the_frame(tmp_path: Path) -> None:
    header = {"type": OpenEXR.scanlineimage}
    path = tmp_path / "a.1.exr"
    for names, count in ((("rgba_main", "N"), 0), (("N", "rgba_main"), 0), (("key", "fill"), 1)):
        pixels = {name: np.zeros_like(GRAY) if name == "N" else GRAY for name in names}
        parts = [
            OpenEXR.Part(dict(header), dict.fromkeys("RGB", gray), name)
            for name, gray in pixels.items()
        ]
        OpenEXR.File(parts).write(str(path))
        frame = read_image(path)
        assert frame.pixels.min() > 0.5
        assert len(frame.warnings) == count
    assert read_image(path, layer="fill").warnings == ()
    with open_frames(tmp_path / "a.%d.exr") as source:
        next(source.frames())
        assert source.warnings[-1].startswith(f"{path}: its layer key")


def test_depth_is_of_the_eye_of_the_image(tmp_path: Path) -> None:
    """As in Beachball/multipart.0001.exr of the images of OpenEXR."""
    path, parts = tmp_path / "a.exr", []
    for name, view, depth_m in (("rgba_right", "right", 0), ("depth_left", "left", 2)):
        names = ("Z",) if depth_m else "RGB"
        values = np.full_like(GRAY, depth_m)
        parts.append(OpenEXR.Part({"view": view}, dict.fromkeys(names, values), name))
    right = OpenEXR.Part({"view": "right"}, {"Z": np.full_like(GRAY, 3)}, "depth_right")
    OpenEXR.File([*parts, right]).write(str(path))
    assert read_image(path).view == "right"
    stored = read_stored_depth(path)
    assert (stored.channel, stored.frame.view) == ("depth_right.Z", "right")
    assert len(stored.warnings) == 1
    left = DepthReadOptions(layer="depth_left")
    assert read_stored_depth(path, left).depth.values.max() == 2
    request = ConvertRequest(str(path), str(tmp_path / "a.preview.png"), image=str(path))
    assert convert(request).target == request.target
    with pytest.raises(InputError):
        convert(replace(request, stated=left))
    channels = read_exr_channels(path)
    assert choose_depth("a.exr", channels, "Depth_Left") == ("depth_left.Z", None)
    with pytest.raises(InputError):
        choose_depth("a.exr", channels, "none")


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
    """Those about an image of which a share of the pixels is above 1, in blue or in Y."""
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


@pytest.mark.parametrize("primaries", [REC_709, REC_601])
def test_primaries_of_screens_are_silent(primaries: tuple[float, ...], tmp_path: Path) -> None:
    assert warnings_of(tmp_path / "a.exr", chromaticities=primaries) == []


@pytest.mark.parametrize("primaries", PUBLISHED)
def test_colours_become_those_of_rec_709(primaries: tuple[float, ...], tmp_path: Path) -> None:
    matrix, problem = primaries_matrix(primaries)
    assert problem is None
    np.testing.assert_allclose(matrix, PUBLISHED[primaries], atol=2e-4)
    np.testing.assert_allclose(matrix @ np.ones(3), 1, atol=1e-5)  # white stays white
    light = np.random.default_rng(0).uniform(0, 2, (50, 40, 3)).astype(np.float32)
    light[0, 0] = np.nan, np.inf, 0.5
    header = {"type": OpenEXR.scanlineimage, "chromaticities": primaries}
    channels = {colour: light[..., i].copy() for i, colour in enumerate("RGB")}
    OpenEXR.File(header, channels).write(str(tmp_path / "a.exr"))
    pixels = read_exr_image(tmp_path / "a.exr", options=ReadOptions(exposure=-1)).pixels
    assert np.isfinite(pixels).all()
    expected = np.clip(light[1:].astype(np.float64) / 2 @ np.transpose(PUBLISHED[primaries]), 0, 1)
    curve = np.where(expected <= 0.0031308, 12.92 * expected, 1.055 * expected ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(pixels[1:], curve, atol=2e-3)


@pytest.mark.parametrize(
    "primaries",
    [
        (float("nan"), *ACES[1:]),
        (*ACES[:7], 0.0),
        (0.0,) * 8,
        (0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3),
    ],
)
def test_primaries_that_are_none_are_told(primaries: tuple[float, ...], tmp_path: Path) -> None:
    (warning,) = warnings_of(tmp_path / "a.exr", chromaticities=primaries)
    assert "primaries" in warning
    assert warnings_of(tmp_path / "a.exr", colours="Y", chromaticities=primaries) == []


@pytest.mark.parametrize("stops", [-2.0, 0.5, 3])
def test_exposure_is_in_stops_of_light(stops: float, tmp_path: Path) -> None:
    light = np.geomspace(1e-3, 4, 200, dtype=np.float32).reshape(10, 20)
    path, brighter = tmp_path / "a.exr", tmp_path / "b.exr"
    for file, factor in ((path, 1.0), (brighter, 2**stops)):
        header = {"type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"Y": light * np.float32(factor)}).write(str(file))
    expected = read_exr_image(brighter).pixels
    np.testing.assert_allclose(read_image(path, exposure=stops).pixels, expected, atol=1e-6)
    for stopped in (21, float("nan")):
        with pytest.raises(UsageError, match="-20 to 20"):
            read_image(path, exposure=stopped)


def test_luminance_and_chroma_are_colours(tmp_path: Path) -> None:
    """mrdoob/three.js#28134, AcademySoftwareFoundation/OpenImageIO#4051."""
    red, green, blue = np.random.default_rng(0).uniform(0.1, 1, (3, 40, 50)).astype(np.float32)
    luminance = np.float32(0.2126) * red + np.float32(0.7152) * green + np.float32(0.0722) * blue
    light = {"Y": luminance, "RY": red / luminance - 1, "BY": blue / luminance - 1}
    frames = []
    for channels in ({"R": red, "G": green, "B": blue}, light):
        OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(tmp_path / "a.exr"))
        frames.append(read_exr_image(tmp_path / "a.exr").pixels)
    np.testing.assert_allclose(*frames, atol=2e-4)


def test_cube_maps_are_refused(tmp_path: Path) -> None:
    """KernerEnvCube.exr of openexr-images: --projection equirectangular cannot work."""
    header = {"type": OpenEXR.scanlineimage, "envmap": OpenEXR.ENVMAP_CUBE}
    OpenEXR.File(header, {"Y": np.zeros((48, 8), np.float32)}).write(str(tmp_path / "a.exr"))
    with pytest.raises(InputError, match="cube map"):
        read_image(tmp_path / "a.exr")
