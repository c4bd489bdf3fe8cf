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
        *((name, Format.PNG16) for name in ("x.png", "x.depth.png", "preview.png")),
        *((name, Format.PREVIEW) for name in ("x.preview.png", "in.preview.png/X.PREVIEW.PNG")),
        *((name, Format.EXR) for name in ("in.preview.png/x.exr", "x.depth.exr")),
        *((name, Format.TIFF) for name in ("x.depth.TIFF", "x.tif")),
        *(("x.NPY", Format.NPY), ("x.normals.png", Format.NORMALS), ("x.depth.json", Format.JSON)),
        *(("x.png.geometric.bin", Format.COLMAP), ("x.gif", None), ("x", None)),
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
    plain, other = (
        WriterOptions(),
        WriterOptions(
            png_scale=256.0,
            exr_channel="Z",
            half=True,
            colormap="turbo",
            vmin=1.0,
            legend=True,
            stride=2,
            faces=True,
            eye_distance_m=0.1,
        ),
    )
    assert plain.writer(name) == writer_class(name)()
    for option in (field.name for field in fields(plain)):
        expected = other if option in FORMATS[name].options else plain
        assert getattr(other.writer(name), option, None) in {getattr(expected, option), None}
