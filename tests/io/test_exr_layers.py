"""Which layer of an EXR is its picture."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import OpenEXR
import pytest
from helpers.plates import depth_channel

from depthcli.errors import InputError
from depthcli.io.depth.read import DepthReadOptions, read_stored_depth
from depthcli.io.exr.file import choose_depth, colour_channels, read_exr_channels
from depthcli.io.images.read import read_image
from depthcli.jobs.convert import ConvertRequest, convert
from depthcli.video.source import open_frames

if TYPE_CHECKING:
    from pathlib import Path

BLENDER = ("ViewLayer.Emit", "ViewLayer.Combined", "ViewLayer.DiffCol")
GRAY = np.full((4, 6), 0.5, np.float32)


def channels_of(*layers: str) -> list[str]:
    return [f"{layer}.{colour}".removeprefix(".") for layer in layers for colour in "ABGR"]


@pytest.mark.parametrize(
    ("layers", "wanted"),
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
def test_the_picture_is_found_by_its_name(layers: tuple[str, ...], wanted: str) -> None:
    expected = tuple(wanted + colour for colour in "RGB"), None
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


def test_luminance_is_a_picture_but_no_part_of_a_vector() -> None:
    assert colour_channels("a.exr", ["BY", "RY", "Y", *channels_of("b")]) == (("Y",), None)
    for names in (["X", "Y", "Z"], ["N.X", "N.Y", "N.Z"], ["R", "G", "b.B"]):
        with pytest.raises(InputError, match=r"a\.exr holds no picture in R, G, B or Y; it has"):
            colour_channels("a.exr", names)


def test_a_layer_can_be_chosen() -> None:
    names = [*channels_of("", "fg.beauty", "bg.Beauty", "fg.N"), "fg.luma.Y", "P.X", "P.Y"]
    for layer, wanted in (
        ("fg.beauty", "fg.beauty."),
        ("BG.beauty", "bg.Beauty."),
        ("fg.beauty.", "fg.beauty."),
        ("n", "fg.N."),
    ):
        expected = tuple(wanted + colour for colour in "RGB")
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


def test_a_layer_has_one_notation() -> None:
    names = sorted([*"RGBrgb", "red", "green", "blue"])
    assert colour_channels("a.exr", names) == (tuple("RGB"), None)
    for names in (
        ["R", "blue", "green"],
        ["fg.b", "fg.green", "fg.r"],
        ["R"],
        ["a.r", "b.g", "c.b"],
    ):
        with pytest.raises(InputError):
            colour_channels("a.exr", names)
    assert depth_channel(["R", "blue", "green"]) == "R"


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
    request = ConvertRequest(str(path), str(tmp_path / "a.preview.png"), picture=str(path))
    assert convert(request).target == request.target
    with pytest.raises(InputError):
        convert(replace(request, stated=left))
    channels = read_exr_channels(path)
    assert choose_depth("a.exr", channels, "Depth_Left") == ("depth_left.Z", None)
    with pytest.raises(InputError):
        choose_depth("a.exr", channels, "none")
