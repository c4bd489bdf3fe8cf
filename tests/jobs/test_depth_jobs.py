"""Depth files looked into and converted by the jobs themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from depthcli.core.camera import Camera
from depthcli.core.types import CameraSource, DepthMap
from depthcli.errors import OutputError, UsageError
from depthcli.io.depth.read import read_depth
from depthcli.io.writers.formats import Format
from depthcli.io.writers.npy import NpyWriter
from depthcli.jobs.convert import ConvertRequest, RoundTrip, convert, target_format
from depthcli.jobs.inspect import MapFacts, depth_at, inspect_file, read_map

if TYPE_CHECKING:
    from pathlib import Path

VALUES_M = np.array([[1.0004, 2, np.nan, 70]], np.float32)


@pytest.fixture
def depth_npy(tmp_path: Path) -> Path:
    path = tmp_path / "d.npy"
    NpyWriter().write(DepthMap(VALUES_M), path)
    return path


def test_a_file_s_facts_are_values(depth_npy: Path) -> None:
    facts = inspect_file(str(depth_npy))
    assert isinstance(facts, MapFacts)
    assert (facts.kind, facts.unit, facts.width, facts.height) == ("metric", "m", 4, 1)
    assert (facts.valid, facts.min, facts.median, facts.max) == (3, VALUES_M[0, 0], 2, 70)
    with pytest.raises(UsageError, match="a scale is for PNG"):
        inspect_file(str(depth_npy), 256)


def test_a_pixel_has_depth_or_none(depth_npy: Path) -> None:
    depth = read_map(depth_npy)
    assert (depth_at(depth, 1, 0), depth_at(depth, 2, 0)) == (2, None)
    with pytest.raises(UsageError, match="4,0 is outside"):
        depth_at(depth, 4, 0)


def test_what_a_conversion_cost(depth_npy: Path, capfd: pytest.CaptureFixture[str]) -> None:
    target = depth_npy.with_name("d.png")
    camera = Camera(focal_px=8)
    done = convert(ConvertRequest(str(depth_npy), str(target), camera=camera))
    assert done.round_trip is not None
    assert done.round_trip.lost == 0
    assert done.round_trip.max_error == pytest.approx(70 - 65.535, rel=1e-5)
    (warning,) = done.warnings
    assert "65.535" in warning
    known = read_depth(target).provenance
    assert known is not None
    assert (known.focal_px, known.camera_source) == (8, CameraSource.OPTION)
    assert capfd.readouterr() == ("", "")


def test_a_format_that_is_not_read_back_has_no_cost(depth_npy: Path) -> None:
    request = ConvertRequest(str(depth_npy), str(depth_npy.with_name("d.preview.png")))
    assert convert(request).round_trip is None


def test_a_target_without_suffix_gets_the_format_s(depth_npy: Path) -> None:
    done = convert(ConvertRequest(str(depth_npy), str(depth_npy.with_name("x")), Format.EXR))
    assert done.target == str(depth_npy.with_name("x.depth.exr"))
    assert read_depth(depth_npy.with_name("x.depth.exr")).width == done.depth.width


@pytest.mark.parametrize("wanted", Format)
def test_a_target_s_own_suffix_matches(tmp_path: Path, wanted: Format) -> None:
    for name in (f"a{wanted.facts.suffix}", f"a{wanted.facts.ending or '.png'}", "a.dat"):
        assert target_format(str(tmp_path / name), wanted) is wanted


def test_a_target_s_suffix_has_to_match_its_format(depth_npy: Path) -> None:
    with pytest.raises(UsageError, match=r"does not end in \.exr"):
        convert(ConvertRequest(str(depth_npy), "other.npy", Format.EXR))


def test_nothing_is_lost_where_nothing_was() -> None:
    nothing = DepthMap(np.full((2, 2), np.nan, np.float32))
    assert RoundTrip.of(nothing, nothing) == RoundTrip(0, 0, 0)


def test_a_file_is_never_its_own_target(depth_npy: Path) -> None:
    with pytest.raises(OutputError, match="is an input"):
        convert(ConvertRequest(str(depth_npy), str(depth_npy)))
