"""The table of output formats: what a file's name says."""

from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.api.depth_map import DepthMap
from depthcli.core.types import Frame
from depthcli.errors import OutputError, UsageError
from depthcli.io.formats.table import (
    FORMATS,
    Format,
    WriterOptions,
    fits,
    format_of,
    stem_of,
    writer_class,
)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("x.png", Format.PNG16),
        ("x.depth.png", Format.PNG16),
        ("x.preview.png", Format.PREVIEW),
        ("in.preview.png/X.PREVIEW.PNG", Format.PREVIEW),
        ("in.preview.png/x.exr", Format.EXR),
        ("preview.png", Format.PNG16),
        ("x.depth.exr", Format.EXR),
        ("x.NPY", Format.NPY),
        ("x.ply", Format.PLY),
        ("x.glb", Format.GLB),
        ("x.normals.png", Format.NORMALS),
        ("x.stereo.png", Format.STEREO),
        ("x.depth.json", Format.JSON),
        ("x.pfm", Format.PFM),
        ("x.depth.TIFF", Format.TIFF),
        ("x.tif", Format.TIFF),
        ("x.png.geometric.bin", Format.COLMAP),
        ("x.gif", None),
        ("x", None),
    ],
)
def test_a_name_says_its_format(name: str, wanted: Format | None) -> None:
    assert format_of(name) == wanted


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("x.png", "x"),
        ("x.preview.png", "x"),
        ("x.Depth.PNG", "x"),
        ("x.tar.gz", "x.tar.gz"),
        ("1305031102.160407", "1305031102.160407"),
        ("1305031102.160407.depth.png", "1305031102.160407"),
        ("x.y.exr", "x.y"),
        ("x", "x"),
        (".ply", ".ply"),
    ],
)
def test_the_rest_is_the_stem(name: str, stem: str) -> None:
    assert stem_of(name) == stem


def test_options_are_those_of_the_format_that_the_name_says(tmp_path: Path) -> None:
    depth = DepthMap(np.full((2, 3), 1.5, np.float32))
    depth.save(tmp_path / "a.png", png_scale=5000)
    assert cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED).max() == 7500
    for name in ("b.png", "b.gif"):
        with pytest.raises(UsageError):
            depth.save(tmp_path / name, half=True)
    frame = Frame(np.zeros((2, 3, 3), np.uint8), tmp_path / "a.png")
    with pytest.raises(OutputError):
        DepthMap.of(depth, frame).save(tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize(
    ("name", "asked", "fitting"),
    [
        ("a.png", Format.PNG16, True),
        ("a.PNG", Format.PREVIEW, True),
        ("a.preview.png", Format.PNG16, True),
        ("a.png", Format.EXR, False),
        ("a.preview.png", Format.NPY, False),
        ("a.depth.exr", Format.EXR, True),
        ("a", Format.EXR, True),
        ("a.gif", Format.PLY, True),
    ],
)
def test_a_name_fits_a_format_that_it_does_not_deny(
    name: str, asked: Format, fitting: bool
) -> None:
    assert fits(name, asked) is fitting


@pytest.mark.parametrize("name", Format)
def test_each_writer_takes_its_options_and_has_their_defaults(name: Format) -> None:
    assert WriterOptions().writer(name) == writer_class(name)()
    others = {
        "png_scale": 256.0,
        "png_normalize": True,
        "png_inverse": True,
        "exr_channel": "Z",
        "half": True,
        "colormap": "turbo",
        "near": "black",
        "vmin": 1.0,
        "vmax": 2.0,
        "legend": True,
        "side_by_side": True,
        "stride": 2,
        "max_depth_m": 5.0,
        "keep_edges": True,
        "faces": True,
        "stereo_layout": "anaglyph",
        "eye_distance_m": 0.1,
        "convergence_m": 2.0,
    }
    assert {field.name for field in fields(WriterOptions)} == others.keys()
    writer = WriterOptions(**others).writer(name)
    for option in others.keys() & set(FORMATS[name].options):
        assert getattr(writer, option) == others[option]
