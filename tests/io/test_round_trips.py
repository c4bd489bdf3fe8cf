"""Every format gives back what was written, within what it promises."""

from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.io.depth.read import DepthReadOptions, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.table import FORMATS, Format, WriterOptions, format_of, writer_class

SHAPES = array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9)
ANY_FLOAT = arrays(np.float32, SHAPES, elements=st.floats(width=32, allow_nan=True))
METRES = arrays(np.float32, SHAPES, elements=st.floats(0.0009765625, 65, width=32))


def written(writer: Any, depth: DepthMap, suffix: str, **reading: Any) -> DepthMap:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"depth{suffix}"
        writer.write(depth, path)
        return read_stored_depth(path, DepthReadOptions(**reading)).displayed


@given(METRES)
def test_png_is_exact_to_half_a_millimetre(values: np.ndarray) -> None:
    found = written(Png16Writer(), DepthMap(values), ".png").values
    assert np.abs(found - values).max() <= 0.0005 + 65 * 1e-6


@pytest.mark.parametrize("scale", [256.0, 4000.0, 5000.0])
def test_png_scales_are_read_back_and_can_be_stated(scale: float, tmp_path: Path) -> None:
    depth = DepthMap(np.array([[1.0, 2.5]], np.float32))
    Png16Writer(png_scale=scale).write(depth, tmp_path / "a.png")
    for stated in (None, scale):
        found = read_stored_depth(tmp_path / "a.png", DepthReadOptions(stated)).displayed.values
        assert found == pytest.approx(depth.values, abs=0.5 / scale)


def test_png_marks_invalid_and_saturates_without_wrapping(tmp_path: Path) -> None:
    values = np.array([[np.nan, np.inf, -1, 0, 0.0001, 65.535, 65.536, 70, 1e9]], np.float32)
    warnings = Png16Writer().write(DepthMap(values), tmp_path / "a.png")
    found = read_stored_depth(tmp_path / "a.png").displayed.values[0]
    assert np.isnan(found[:4]).all()
    assert found[4] == pytest.approx(0.001)
    assert found[5:] == pytest.approx(np.full(4, 65.535))
    assert warnings == ("4 pixels beyond 65.535 m were saturated",)


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_png_without_metres_is_normalized_and_says_so(kind: DepthKind, tmp_path: Path) -> None:
    depth = DepthMap(np.array([[-3.0, 0.5, np.nan, 7.0]], np.float32), kind)
    assert Png16Writer().write(depth, tmp_path / "a.png")
    found = read_stored_depth(tmp_path / "a.png").displayed
    assert found.kind is kind
    assert found.values == pytest.approx(depth.values, abs=1e-3, nan_ok=True)


@settings(deadline=None, max_examples=25)
@given(ANY_FLOAT, st.sampled_from(["Z", "Y", "R", "depth.Z"]))
def test_exr_is_exact(values: np.ndarray, channel: str) -> None:
    found = written(ExrWriter(exr_channel=channel), DepthMap(values), ".exr")
    assert np.array_equal(found.values, values, equal_nan=True)


def test_exr_is_compressed_by_zip(tmp_path: Path) -> None:
    ExrWriter().write(DepthMap(np.ones((4, 5), np.float32)), tmp_path / "a.exr")
    header = OpenEXR.File(str(tmp_path / "a.exr"), header_only=True).header()
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION


def test_half_exr_keeps_eleven_bits(tmp_path: Path) -> None:
    values = np.linspace(0.3, 10, 60, dtype=np.float32).reshape(6, 10)
    ExrWriter(half=True).write(DepthMap(values), tmp_path / "a.exr")
    assert read_stored_depth(tmp_path / "a.exr").displayed.values == pytest.approx(
        values, rel=2**-11
    )


@given(ANY_FLOAT)
def test_npy_is_exact(values: np.ndarray) -> None:
    found = written(NpyWriter(), DepthMap(values), ".npy", kind=DepthEncoding.RELATIVE)
    assert np.array_equal(found.values, values, equal_nan=True)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_keeps_the_contract(name: Format, tmp_path: Path) -> None:
    facts = FORMATS[name]
    assert facts.suffix.startswith(".")
    assert format_of(f"a{facts.suffix}") is name
    assert facts.file_suffix is None or format_of(f"a{facts.file_suffix}") is name
    path = tmp_path / f"a{facts.suffix}"
    frame = Frame(np.zeros((4, 5, 3), np.uint8))
    options = WriterOptions()
    # What a writer does by itself is what it does with the options' own defaults.
    assert options.writer(name) == writer_class(name)()
    assert set(facts.options) <= {field.name for field in fields(options)}
    warnings = options.writer(name).write(DepthMap(np.full((4, 5), 2, np.float32)), path, frame)
    assert isinstance(warnings, tuple)
    assert path.stat().st_size > 0
