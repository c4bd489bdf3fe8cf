"""The table of output formats: what a file's name says."""

from __future__ import annotations

import pytest

from depthcli.io.writers.formats import Format, format_of, stem_of


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
        ("x.depth.json", Format.JSON),
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
        ("x.tar.gz", "x.tar"),
        ("x.y.exr", "x.y"),
        ("x", "x"),
        (".ply", ".ply"),
    ],
)
def test_the_rest_is_the_stem(name: str, stem: str) -> None:
    assert stem_of(name) == stem
