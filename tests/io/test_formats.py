"""Formats of depth: their table, what comes back of each, and files of other programs."""

import zipfile
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError, OutputError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.raster import FloatWriter, Png16Writer, SidecarWriter
from depthcli.io.formats.table import (
    FORMATS,
    Format,
    WriterOptions,
    format_of,
    stem_of,
    writer_class,
    writer_of,
)
from depthcli.io.guard import is_own
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.io.stored.metadata import DepthScale


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        *((name, Format.PNG16) for name in ("x.png", "x.depth.png", "preview.png")),
        *((name, Format.PREVIEW) for name in ("x.preview.png", "in.preview.png/X.PREVIEW.PNG")),
        *((name, Format.EXR) for name in ("in.preview.png/x.exr", "x.depth.exr")),
        *((name, Format.TIFF) for name in ("x.depth.TIFF", "x.tif")),
        *(("x.NPY", Format.NPY), ("x.normals.png", Format.NORMALS), ("x.depth.json", Format.JSON)),
        *(("x.png.geometric.bin", Format.COLMAP), ("x.gif", None), ("x", None)),
    ],
)
def test_a_name_says_its_format(name: str, expected: Format | None) -> None:
    assert format_of(name) == expected


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
    facts = FORMATS[name]
    assert format_of(f"a{facts.suffix}") is name
    assert facts.file_suffix is None or format_of(f"a{facts.file_suffix}") is name
    # What a writer does by itself is what it does with the options' own defaults.
    assert writer_of(name, plain) == writer_class(name)()
    for option in (field.name for field in fields(plain)):
        expected = other if option in facts.options else plain
        assert getattr(writer_of(name, other), option, None) in {getattr(expected, option), None}


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
    read_back = written(Png16Writer(), DepthMap(values), ".png").values
    assert np.abs(read_back - values).max() <= 0.0005 + 65 * 1e-6


def test_png_marks_invalid_and_saturates_without_wrapping(tmp_path: Path) -> None:
    values = np.array([[np.nan, np.inf, -1, 0, 0.0001, 65.535, 65.536, 70, 1e9]], np.float32)
    warnings = Png16Writer().write(DepthMap(values), tmp_path / "a.png")
    depth_m = read_stored_depth(tmp_path / "a.png").displayed.values[0]
    assert np.isnan(depth_m[:4]).all()
    assert depth_m[4] == pytest.approx(0.001)
    assert depth_m[5:] == pytest.approx(np.full(4, 65.535))
    assert warnings == ("4 pixels beyond 65.535 m were saturated",)


@pytest.mark.parametrize("kind", [DepthKind.RELATIVE, DepthKind.INVERSE])
def test_png_without_metres_is_normalized_and_says_so(kind: DepthKind, tmp_path: Path) -> None:
    depth = DepthMap(np.array([[-3.0, 0.5, np.nan, 7.0]], np.float32), kind)
    assert Png16Writer().write(depth, tmp_path / "a.png")
    read_back = read_stored_depth(tmp_path / "a.png").displayed
    assert read_back.kind is kind
    assert read_back.values == pytest.approx(depth.values, abs=1e-3, nan_ok=True)


@settings(deadline=None, max_examples=25)
@given(ANY_FLOAT, st.sampled_from(["Z", "Y", "R", "depth.Z"]))
def test_exr_is_exact(values: np.ndarray, channel: str) -> None:
    depth = DepthMap(values)
    read_back = written(ExrWriter(exr_channel=channel), depth, ".exr")
    assert np.array_equal(read_back.values, np.where(depth.valid, values, np.nan), equal_nan=True)


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
    depth = DepthMap(values, DepthKind.RELATIVE)
    read_back = written(FloatWriter(), depth, ".npy", kind=DepthEncoding.RELATIVE)
    assert np.array_equal(read_back.values, np.where(depth.valid, values, np.nan), equal_nan=True)


DEPTH_M = np.linspace(0.5, 9, 12, dtype=np.float32).reshape(3, 4)
HOLED_M = np.where(np.arange(12).reshape(3, 4) == 5, np.float32(np.nan), DEPTH_M)
FURTHER = (Format.PFM, Format.TIFF, Format.PGM, Format.NPZ, Format.COLMAP)


def pfm(values: np.ndarray, scale: str = "-1.0", order: str = "<f4", end: str = "\n") -> bytes:
    height, width = values.shape[:2]
    head = f"Pf{end}{width} {height}{end}{scale}{end}".encode()
    return head + values[::-1].astype(order).tobytes()


def colmap(values: np.ndarray) -> bytes:
    """As ``write_array`` of COLMAP's read_write_dense.py."""
    height, width = values.shape[:2]
    channels = np.atleast_3d(values)
    by_column = np.transpose(channels, (1, 0, 2)).reshape(-1, order="F")
    return f"{width}&{height}&{channels.shape[2]}&".encode() + by_column.astype("<f4").tobytes()


@pytest.mark.parametrize("format_", FURTHER)
def test_round_trip(format_: Format, tmp_path: Path) -> None:
    path = tmp_path / f"a{format_.facts.suffix}"
    assert writer_class(format_)().write(DepthMap(HOLED_M), path) == ()
    depth = read_stored_depth(path).depth
    assert depth.valid.tolist() == (~np.isnan(HOLED_M)).tolist()
    atol = 0 if format_.facts.is_exact else 0.0005
    np.testing.assert_allclose(depth.values[depth.valid], HOLED_M[depth.valid], 1e-6, atol)
    assert is_own(path)


def test_files_as_other_programs_read_them(tmp_path: Path) -> None:
    for format_ in FURTHER:
        writer_class(format_)().write(DepthMap(DEPTH_M), tmp_path / f"a{format_.facts.file_suffix}")
    for name in ("a.pfm", "a.tiff"):
        read = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(read, DEPTH_M)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.tiff")), DEPTH_M)
    steps = np.rint(DEPTH_M * 1000).astype(int)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.pgm"), int), steps)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npz")["depth"], DEPTH_M)
    assert (tmp_path / "a.bin").read_bytes() == colmap(DEPTH_M)


@pytest.mark.parametrize(
    ("scale", "order", "end"),
    [
        ("-1.0", "<f4", "\n"),
        ("1", ">f4", "\n"),
        ("-0.003922", "<f4", "\r\n"),
        ("1e+0", ">f4", "\r"),
    ],
)
def test_pfm_of_other_programs(scale: str, order: str, end: str, tmp_path: Path) -> None:
    """Middlebury's have a scale of 1/255, which is no factor, and infinity where unknown.

    Lines of the header may end in CRLF (Tom94/tev#60).
    """
    values = np.where(np.isnan(HOLED_M), np.inf, HOLED_M)
    (tmp_path / "a.pfm").write_bytes(pfm(values, scale, order, end))
    np.testing.assert_array_equal(read_stored_depth(tmp_path / "a.pfm").depth.values, HOLED_M)


def test_three_equal_channels_are_one_map(tmp_path: Path) -> None:
    """Depth saved from gray with three channels; --frame cannot choose one of them."""
    channels = np.stack([HOLED_M.repeat(2, 0)] * 3, -1)
    np.save(tmp_path / "a.npy", channels)
    stored = read_stored_depth(tmp_path / "a.npy").depth.values
    np.testing.assert_array_equal(stored, channels[..., 0])
    channels[0, 0] = 1, 2, 3
    np.save(tmp_path / "a.npy", channels)
    with pytest.raises(InputError, match=r"holds \(6, 4, 3\) float32"):
        read_stored_depth(tmp_path / "a.npy")


def test_colmap_has_no_unit(tmp_path: Path) -> None:
    (tmp_path / "a.jpg.geometric.bin").write_bytes(colmap(np.nan_to_num(HOLED_M)))
    stored = read_stored_depth(tmp_path / "a.jpg.geometric.bin")
    np.testing.assert_array_equal(
        stored.depth.values[stored.depth.valid], HOLED_M[stored.depth.valid]
    )
    assert stored.depth.valid.sum() == 11
    assert len(stored.warnings) == 1
    assert not read_stored_depth(tmp_path / "a.jpg.geometric.bin", DepthReadOptions(1.0)).warnings


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint16])
@pytest.mark.parametrize("suffix", [".tif", ".tiff"])
def test_tiff_of_other_programs(dtype: type, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    units = 1000 if dtype is np.uint16 else 1
    assert cv2.imwrite(str(path), (np.nan_to_num(HOLED_M) * units).astype(dtype))
    stored = read_stored_depth(path)
    assert stored.scale == DepthScale(units, "assumed")
    assert not stored.depth.valid[1, 1]
    np.testing.assert_allclose(stored.depth.values[0], DEPTH_M[0], atol=0.0011)


@pytest.mark.parametrize("names", [("depth",), ("depths", "conf"), ("arr_0",), ("anything",)])
def test_npz_of_other_programs(names: tuple[str, ...], tmp_path: Path) -> None:
    arrays = {name: DEPTH_M[None] + i for i, name in enumerate(names)}
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    np.testing.assert_array_equal(read_stored_depth(tmp_path / "a.npz").depth.values, DEPTH_M)


def test_npz_states_the_camera_of_each_map(tmp_path: Path) -> None:
    """Depth Anything 3 writes depth (N, H, W) and intrinsics (N, 3, 3) in pixels of the maps."""
    cameras = np.array([np.eye(3), [[5, 0, 1.25], [0, 4, 1], [0, 0, 1]]], np.float32)
    np.savez(tmp_path / "a.npz", depth=np.stack([DEPTH_M, DEPTH_M]), intrinsics=cameras)
    first, second = (
        read_stored_depth(tmp_path / "a.npz", DepthReadOptions(frame=i)).depth.provenance
        for i in range(2)
    )
    assert (second.focal_px, second.centre_px, second.pixel_aspect) == (5, (1.25, 1), 0.8)
    assert first.focal_px is None  # in widths of the map, or none


@pytest.mark.parametrize("name", ["disp", "inverse_depth"])
def test_names_of_arrays_imply_inverse_depth(name: str, tmp_path: Path) -> None:
    """As of stereo networks and MiDaS, of which 0.17 took the numbers for metres."""
    np.savez(tmp_path / "a.npz", **{name: DEPTH_M})
    assert read_stored_depth(tmp_path / "a.npz").depth.kind is DepthKind.INVERSE
    options = DepthReadOptions(kind=DepthEncoding.METRIC)
    assert read_stored_depth(tmp_path / "a.npz", options).depth.is_metric


def test_pages_of_a_tiff_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    first, second = (Image.fromarray(DEPTH_M * factor) for factor in (1, 2))
    first.save(path, save_all=True, append_images=[second])
    stored = read_stored_depth(path)
    np.testing.assert_array_equal(stored.depth.values, DEPTH_M)
    assert len(stored.warnings) == 1


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_one_of_several_maps_is_read_by_its_number(name: str, tmp_path: Path) -> None:
    """Video Depth Anything and Depth Anything 3 write (N, H, W)."""
    several = np.stack([DEPTH_M, 2 * DEPTH_M])
    np.save(tmp_path / "a.npy", several)
    np.savez(tmp_path / "a.npz", depths=several)
    depth = read_stored_depth(tmp_path / name, DepthReadOptions(frame=1)).depth
    np.testing.assert_array_equal(depth.values, several[1])
    for frame in (None, 2):
        with pytest.raises(InputError):
            read_stored_depth(tmp_path / name, DepthReadOptions(frame=frame))


def test_npz_keeps_kind_and_model(tmp_path: Path) -> None:
    writer_class(Format.NPZ)().write(DepthMap(DEPTH_M, DepthKind.INVERSE), tmp_path / "a.npz")
    assert read_stored_depth(tmp_path / "a.npz").depth.kind is DepthKind.INVERSE


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.pfm", b"PF\n4 3\n-1\n" + bytes(144), "float map, so it holds no depth"),
        ("a.pfm", pfm(DEPTH_M)[:-1], None),
        ("a.pfm", b"Pf\n0 0\n-1\n", None),
        ("a.pfm", b"P5", None),
        ("a.bin", colmap(np.dstack([DEPTH_M] * 3)), "of one channel, so it holds no depth"),
        ("a.bin", colmap(DEPTH_M)[:-1], None),
        ("a.bin", b"\x00\x01", None),
        ("a.tif", b"II*\0", None),
        ("a.pgm", b"P5\n2 2\n255\n0000", None),
        ("a.npz", b"PK", None),
        ("a.npz", b"", None),
    ],
)
def test_file_without_depth_is_refused(
    name: str, content: bytes, message: str | None, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_stored_depth(tmp_path / name)


def test_an_npz_without_a_usual_name_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", left=DEPTH_M, right=DEPTH_M)
    with pytest.raises(InputError):
        read_stored_depth(tmp_path / "a.npz")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as file:
        file.writestr("depth.npy", b"no array")
    with pytest.raises(InputError):
        read_stored_depth(tmp_path / "b.npz")


@pytest.mark.parametrize("suffix", [".png", ".pgm"])
def test_normalized_inverse_depth(suffix: str, tmp_path: Path) -> None:
    """Near is white, linear in 1/depth, as ControlNet and 3D Gaussian splatting expect."""
    path, writing = tmp_path / f"a{suffix}", WriterOptions(png_inverse=True)
    format_ = Format.PNG16 if suffix == ".png" else Format.PGM
    writer_of(format_, writing).write(DepthMap(HOLED_M), path)
    steps = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert (steps[0, 0], steps[1, 1], steps[2, 3]) == (65535, 0, 1)
    share = (1 / HOLED_M - 1 / 9) / (1 / 0.5 - 1 / 9)
    np.testing.assert_allclose(steps, np.nan_to_num(1 + 65534 * share), atol=0.6)
    depth = read_stored_depth(path).depth
    assert depth.is_metric
    np.testing.assert_allclose(depth.values, HOLED_M, rtol=2e-4)
    # Saved again without its texts, the sidecar says what it is.
    writer_of(Format.JSON, writing).write(DepthMap(HOLED_M), tmp_path / "a.json")
    cv2.imwrite(str(path), steps)
    np.testing.assert_allclose(read_stored_depth(path).depth.values, HOLED_M, rtol=2e-4)
    assert SidecarWriter(png_inverse=True) == writer_of(Format.JSON, writing)


@pytest.mark.parametrize("suffix", [".png", ".pgm"])
@pytest.mark.parametrize("option", ["png_normalize", "png_inverse"])
def test_depth_has_one_number_in_all_maps_of_a_stated_range(
    option: str, suffix: str, tmp_path: Path
) -> None:
    writing = WriterOptions(**{option: True}, vmin=1, vmax=16)
    format_ = Format.PNG16 if suffix == ".png" else Format.PGM
    share = (2 - 1) / (16 - 1) if option == "png_normalize" else (1 / 2 - 1 / 16) / (1 - 1 / 16)
    for others, beyond in (((1.5, 3.0), 0), ((0.5, 30.0), 2), ((2.0, np.nan), 0)):
        path, depth = tmp_path / f"a{suffix}", DepthMap(np.array([[2.0, *others]], np.float32))
        warnings = writer_of(format_, writing).write(depth, path)
        assert [int(warning.split()[0]) for warning in warnings] == ([beyond] if beyond else [])
        steps = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert steps[0, 0] == round(1 + share * 65534)
        expected = np.clip(depth.values, 1, 16)
        np.testing.assert_allclose(read_stored_depth(path).depth.values, expected, rtol=2e-4)
        # Saved again without its texts, the sidecar says what it is.
        writer_of(Format.JSON, writing).write(depth, tmp_path / "a.json")
        cv2.imwrite(str(path), steps)
        np.testing.assert_allclose(read_stored_depth(path).depth.values, expected, rtol=2e-4)


def test_one_end_of_a_range_leaves_the_other_to_the_map(tmp_path: Path) -> None:
    path, depth = tmp_path / "a.png", DepthMap(np.array([[1.0, 2.0, 4.0]], np.float32))
    for ends, steps in (
        ({"vmin": 2}, [1, 1, 65535]),
        ({"vmax": 2}, [1, 65535, 65535]),
    ):
        Png16Writer(png_normalize=True, **ends).write(depth, path)
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[0].tolist()
        assert pixels == steps, ends
    for ends in ({"vmin": 0}, {"vmax": -1}):
        with pytest.raises(OutputError):
            Png16Writer(png_inverse=True, **ends).write(depth, path)


def test_inverse_depth_of_a_model_without_unit_keeps_near_white(tmp_path: Path) -> None:
    depth = DepthMap(DEPTH_M, DepthKind.INVERSE)
    Png16Writer(png_inverse=True).write(depth, tmp_path / "a.png")
    steps = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert (steps[0, 0], steps[2, 3]) == (1, 65535)
    relative = DepthMap(DEPTH_M, DepthKind.RELATIVE)  # has no inverse
    (warning,) = Png16Writer(png_inverse=True).write(relative, tmp_path / "a.png")
    assert "far is white" in warning
