"""Metadata of depth files, and conventions of other programs."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image

import depthcli
from depthcli.core.camera import CameraSource, Intrinsics
from depthcli.core.options import DepthEncoding, DepthFit
from depthcli.core.types import AnchorFit, DepthKind, DepthMap, Provenance, with_camera
from depthcli.errors import InputError, OutputError
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.geometry import PlyWriter
from depthcli.io.formats.raster import FloatWriter, Png16Writer, SidecarWriter
from depthcli.io.formats.table import FORMATS, Format, writer_class
from depthcli.io.stored.depth import DepthReadOptions, StoredDepth
from depthcli.io.stored.metadata import DepthScale
from depthcli.jobs.convert import ConvertRequest, convert

WORDS = {
    CameraSource.OPTION: "hfov 90.0° (given)",
    CameraSource.EXIF: "hfov 90.0° (from EXIF)",
    CameraSource.CARD: "hfov 90.0° (assumed, from the model's card)",
    None: "hfov 90.0°",
}


def seen_by(source: CameraSource | None, focal_px: float | None = 2.0) -> DepthMap:
    """A map of 4 columns: 90 degrees at a focal length of 2 pixels."""
    depth_m = np.ones((3, 4), np.float32)
    return DepthMap(depth_m, provenance=Provenance(focal_px=focal_px, camera_source=source))


@pytest.mark.parametrize(
    ("writer", "name"),
    [(Png16Writer(), "a.png"), (ExrWriter(), "a.exr"), (FloatWriter(), "a.npy")],
    ids=["png", "exr", "npy"],
)
@pytest.mark.parametrize("source", WORDS)
def test_a_file_says_which_camera(
    tmp_path: Path,
    writer: Png16Writer | ExrWriter | FloatWriter,
    name: str,
    source: CameraSource | None,
) -> None:
    path = tmp_path / name
    writer.write(seen_by(source), path)
    if isinstance(writer, FloatWriter):  # which has no room for words
        SidecarWriter().write(seen_by(source), path.with_suffix(".json"))
    assert read_metadata(path)["camera"] == WORDS[source]
    provenance = read_stored_depth(path).displayed.provenance
    assert (provenance.focal_px, provenance.camera_source) == (2, source)


def _changed_by_another_program(path: Path, rows: slice, columns: slice) -> Path:
    """An EXR whose pixels were replaced, but not its header, as OpenImageIO and Nuke do."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header, pixels = dict(file.header()), file.channels()["Y"].pixels[rows, columns]
    for window in ("dataWindow", "displayWindow"):
        header.pop(window)
    OpenEXR.File(header, {"Y": np.ascontiguousarray(pixels)}).write(str(path))
    return path


def _wide(tmp_path: Path) -> Path:
    depth_m = np.full((48, 64), 2, np.float32)
    camera = Provenance(focal_px=55.4256, centre_px=(40.0, 20.0), camera_source=CameraSource.OPTION)
    path = tmp_path / "a.exr"
    ExrWriter().write(DepthMap(depth_m, provenance=camera), path)
    return path


def test_focal_length_of_resized_depth_is_scaled(tmp_path: Path) -> None:
    path = _changed_by_another_program(_wide(tmp_path), slice(None, None, 4), slice(None, None, 4))
    stored = read_stored_depth(path)
    provenance = stored.displayed.provenance
    assert provenance.focal_px == pytest.approx(55.4256 / 4)
    assert provenance.centre_px == pytest.approx((9.625, 4.625))
    assert stored.metadata["camera"] == "hfov 60.0° (given)"
    assert ["64×48" in text and "16×12" in text for text in stored.warnings] == [True]
    PlyWriter().write(stored.displayed, tmp_path / "a.ply")


def test_focal_length_of_cropped_depth_is_refused(tmp_path: Path) -> None:
    original = _wide(tmp_path)
    assert read_stored_depth(original).warnings == ()
    path = _changed_by_another_program(original, slice(0, 20), slice(10, 50))
    stored = read_stored_depth(path)
    provenance = stored.displayed.provenance
    assert (provenance.focal_px, provenance.centre_px, provenance.is_cropped) == (None, None, True)
    assert not {"camera", "focal_px"} & set(stored.metadata)
    assert ["64" in text and "40×20" in text for text in stored.warnings] == [True]
    with pytest.raises(OutputError):
        PlyWriter().write(stored.displayed, tmp_path / "a.ply")
    depth = with_camera(stored.displayed, Intrinsics(focal_px=50.0))
    PlyWriter().write(depth, tmp_path / "a.ply")
    assert depth.provenance.focal_px == 50


DEPTH_M = np.linspace(0.5, 9, 12, dtype=np.float32).reshape(3, 4)
STATED = Provenance("m", "ab" * 32, focal_px=3.0, orientation=6, camera_source=CameraSource.OPTION)
DEPTH = DepthMap(DEPTH_M, provenance=STATED)
RELATIVE = DepthReadOptions(kind=DepthEncoding.RELATIVE)


def write_map(path: Path, values: np.ndarray) -> None:
    """A map in a file without metadata."""
    write(path, (values * 1000).astype(np.uint16) if path.suffix == ".png" else values)


def is_used(stored: StoredDepth) -> bool:
    """Whether a sidecar adds its facts; if not, a warning names it."""
    if stored.depth.provenance.orientation == 6:
        assert stored.warnings == ()
        return True
    (warning,) = stored.warnings
    assert warning.endswith(
        f"a.json describes another map than {stored.name.rpartition('/')[2]} and is ignored; "
        "remove it, or write it again with sidecar"
    )
    return False


@pytest.mark.parametrize("suffix", [".npy", ".png", ".exr"])
def test_a_sidecar_of_another_size_is_ignored(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    SidecarWriter().write(DEPTH, tmp_path / "a.json")
    for values, expected in ((DEPTH_M, True), (DEPTH_M[:, ::3], False), (DEPTH_M[::2], False)):
        write_map(path, values)
        assert is_used(read_stored_depth(path)) is expected
        assert ("focal_px" in read_metadata(path)) is expected


def test_a_sidecar_of_another_camera_is_not_that_of_a_png(tmp_path: Path) -> None:
    Png16Writer().write(DEPTH, tmp_path / "a.png")
    for focal_px in (3.0, 5.0):
        other = replace(DEPTH, provenance=replace(STATED, focal_px=focal_px))
        SidecarWriter().write(other, tmp_path / "a.json")
        assert is_used(read_stored_depth(tmp_path / "a.png")) == (focal_px == 3)


@pytest.mark.parametrize("suffix", [".npy", ".png", ".exr"])
def test_the_kind_comes_from_the_sidecar(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    SidecarWriter().write(DepthMap(DEPTH_M, DepthKind.INVERSE), tmp_path / "a.json")
    write_map(path, DEPTH_M)
    assert read_stored_depth(path).displayed.kind is DepthKind.INVERSE
    assert read_stored_depth(path, RELATIVE).displayed.kind is DepthKind.INVERSE


@pytest.mark.parametrize("kind", DepthKind)
@pytest.mark.parametrize(
    "options", [{}, {"png_scale": 256.0}, {"png_normalize": True}], ids=["mm", "256", "normalized"]
)
def test_a_png_that_is_saved_again_has_the_scale_of_its_sidecar(
    kind: DepthKind, options: dict[str, float], tmp_path: Path
) -> None:
    path, depth = tmp_path / "a.png", DepthMap(DEPTH_M, kind)
    Png16Writer(**options).write(depth, path)
    SidecarWriter(**options).write(depth, tmp_path / "a.json")
    before = read_stored_depth(path)
    write(path, cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    after = read_stored_depth(path)
    assert (after.scale, after.depth.kind) == (before.scale, kind)
    np.testing.assert_allclose(after.depth.values, before.depth.values, rtol=1e-6)
    np.testing.assert_allclose(after.depth.values, DEPTH_M, atol=0.003)


def test_frame_has_the_scale_of_the_video_sidecar(tmp_path: Path) -> None:
    path = tmp_path / "a.depth.000007.png"
    write(path, (DEPTH_M * 256).astype(np.uint16))
    sidecar = {"software": "depthcli 0.9.0", "frames": 9, "scale": 256.0, "times_s": {"7": 0.5}}
    (tmp_path / "a.depth.json").write_text(json.dumps(sidecar))
    assert read_stored_depth(path).scale == (256, "file")
    (tmp_path / "a.depth.json").write_text(json.dumps(sidecar | {"scale": None}))
    assert read_stored_depth(path).scale == (1000, "assumed")


def test_scale_in_a_png_overrides_its_sidecar(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Png16Writer().write(DEPTH, path)
    for sidecar in (SidecarWriter(png_scale=256), SidecarWriter(png_normalize=True)):
        sidecar.write(DEPTH, tmp_path / "a.json")
        stored = read_stored_depth(path)
        assert stored.scale == (1000, "file")
        assert "range" not in stored.metadata


FIT = AnchorFit(1_234_567, 2_000_000, 0.012346, DepthFit.NETWORK)
FITTED = replace(DEPTH, provenance=replace(STATED, input_size_px=(256, 192), anchor_fit=FIT))


@pytest.mark.parametrize("name", [Format.PNG16, Format.EXR, Format.NPY])
def test_a_file_with_a_sidecar_states_how_its_depth_was_fitted(
    name: Format, tmp_path: Path
) -> None:
    path = tmp_path / f"a{Path(FORMATS[name].suffix).suffix}"
    writer_class(name)().write(FITTED, path)
    SidecarWriter().write(FITTED, tmp_path / "a.json")
    stored = read_stored_depth(path)
    assert (is_used(stored), stored.depth.provenance) == (True, FITTED.provenance)
    SidecarWriter().write(stored.depth, tmp_path / "b.json")
    assert (tmp_path / "b.json").read_bytes() == (tmp_path / "a.json").read_bytes()
    assert depthcli.read_depth(path).anchor_fit == FIT


@pytest.mark.parametrize("writer", [Png16Writer(), ExrWriter()])
def test_png_and_exr_state_the_fit_themselves(
    writer: Png16Writer | ExrWriter, tmp_path: Path
) -> None:
    path = tmp_path / ("a.png" if isinstance(writer, Png16Writer) else "a.exr")
    for depth, expected in ((FITTED, "1234567,2000000,0.012346,network"), (DEPTH, None)):
        writer.write(depth, path)
        assert read_metadata(path).get("anchors") == expected
        assert depthcli.read_depth(path).anchor_fit == (expected and FIT)
    # The fit in the sidecar of an earlier run is not that of the map.
    SidecarWriter().write(FITTED, tmp_path / "a.json")
    assert not is_used(read_stored_depth(path))


PLANE_M = np.linspace(2, 4, 48, dtype=np.float32).reshape(6, 8)
HFOV = Intrinsics(hfov_deg=60)


def write(path: Path, values: np.ndarray, channel: str = "Z") -> Path:
    if path.suffix == ".exr":
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {channel: np.ascontiguousarray(values)}).write(str(path))
    elif path.suffix == ".npy":
        np.save(path, values)
    else:
        cv2.imwrite(str(path), values)
    return path


def depth_of(path: Path, **options: Any) -> np.ndarray:
    return read_stored_depth(path, DepthReadOptions(**options)).displayed.values


@pytest.mark.parametrize("name", ["a.exr", "a.npy"])
@pytest.mark.parametrize("units_per_metre", [100, 1000])
def test_floats_have_a_unit(name: str, units_per_metre: float, tmp_path: Path) -> None:
    """Unreal writes centimetres (PerceivingSystems/bedlam_render#14), Ensenso millimetres."""
    path = write(tmp_path / name, PLANE_M * np.float32(units_per_metre))
    assumed = read_stored_depth(path)
    assert assumed.scale == DepthScale(1.0, "assumed")
    assert len(assumed.warnings_with_scale("from_scale")) == 1  # hardly metres
    for options in ({"scale": units_per_metre}, {"unstated_scale": units_per_metre}):
        np.testing.assert_allclose(depth_of(path, **options), PLANE_M, rtol=1e-6)


@pytest.mark.parametrize("name", ["a.exr", "a.npy"])
def test_normalized_depth_is_told(name: str, tmp_path: Path) -> None:
    """V-Ray's ZDepth and depth that programs normalize for viewing are from 0 to 1."""
    path = write(tmp_path / name, np.linspace(0, 1, 48, dtype=np.float32).reshape(6, 8))
    assert len(read_stored_depth(path).warnings_with_scale("from_scale")) == 1


def test_mist_and_disparity_are_no_depth(tmp_path: Path) -> None:
    """Blender's mist is from 0 to 1; its depth, if there is any, is found beside it."""
    mist = write(tmp_path / "mist.exr", PLANE_M, "ViewLayer.Mist.Z")
    with pytest.raises(InputError):
        read_stored_depth(mist)
    assert read_stored_depth(mist, DepthReadOptions(layer="Mist")).channel == "ViewLayer.Mist.Z"
    stored = read_stored_depth(write(tmp_path / "stereo.exr", PLANE_M, "disparity.R"))
    assert stored.depth.kind is DepthKind.INVERSE


def test_metres_in_floats_need_no_warning(tmp_path: Path) -> None:
    assert not read_stored_depth(write(tmp_path / "a.npy", PLANE_M)).warnings_with_scale("scale")
    ExrWriter().write(DepthMap(PLANE_M), tmp_path / "own.exr")
    stored = read_stored_depth(tmp_path / "own.exr", DepthReadOptions(unstated_scale=1000))
    assert stored.scale == DepthScale(1.0, "file")
    np.testing.assert_array_equal(stored.depth.values, PLANE_M)


@pytest.mark.parametrize(
    "layer", ["FinalImageWorldDepth.R", "FinalImageMovieRenderQueue_WorldDepth.R"]
)
def test_depth_of_unreal_is_in_centimetres(layer: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.exr", PLANE_M * 100, layer)
    np.testing.assert_allclose(depth_of(path), PLANE_M, rtol=1e-6)
    assert read_stored_depth(path).scale == DepthScale(100, "file")


@pytest.mark.parametrize("background", [1e10, 65504, 1e11, np.finfo(np.float32).max, np.inf])
def test_the_sky_of_a_renderer_is_no_depth(background: float, tmp_path: Path) -> None:
    """Blender writes 1e10 (shubhtuls/mvcSnP#4), or 65504 in half floats."""
    values = PLANE_M.copy()
    values[0] = background
    stored = read_stored_depth(write(tmp_path / "a.exr", values, "ViewLayer.Depth.Z"))
    assert stored.depth.valid.tolist() == [[False] * 8, *[[True] * 8] * 5]
    assert len(stored.warnings) == (background != np.inf)


def test_65535_of_other_programs_is_no_depth(tmp_path: Path) -> None:
    """As 7-Scenes, Taskonomy and Virtual KITTI have it."""
    path = write(tmp_path / "frame-000000.depth.png", np.uint16([[65535, 2000]]))
    np.testing.assert_array_equal(depth_of(path), [[np.nan, 2]])
    assert depth_of(path, kind=DepthEncoding.INVERSE).tolist() == [[65535, 2000]]


@pytest.mark.parametrize("hole", [None, 0.0, 1e10, -np.inf])
def test_depth_along_minus_z_is_positive(hole: float | None, tmp_path: Path) -> None:
    """Maya and OpenGL look along -Z (polycount.com/discussion/comment/1158893)."""
    values = -PLANE_M
    if hole is not None:
        values[0] = hole
    stored = read_stored_depth(write(tmp_path / "a.exr", values))
    np.testing.assert_array_equal(stored.depth.values[1:], PLANE_M[1:])
    assert stored.depth.valid[0].all() == (hole is None)
    assert stored.warnings


def test_minus_one_is_no_depth(tmp_path: Path) -> None:
    values = np.full_like(PLANE_M, -1)
    path = write(tmp_path / "a.npy", values)
    with pytest.raises(InputError):
        convert(ConvertRequest(str(path), str(tmp_path / "out.png")))
    assert not (tmp_path / "out.png").exists()
    values[0, 0] = 2
    done = convert(ConvertRequest(str(write(path, values)), str(tmp_path / "out.png")))
    assert done.round_trip
    assert done.round_trip.lost == 0


@pytest.mark.parametrize(
    ("values", "tag"),
    [(np.float32([[9999, 2, 0]]), "9999"), (np.uint16([[32767, 2000, 0]]), "32767 ")],
)
def test_the_no_data_value_of_gdal_is_no_depth(
    values: np.ndarray, tag: str, tmp_path: Path
) -> None:
    """geotiffjs/geotiff.js#257, geocaml/ocaml-tiff#35."""
    Image.fromarray(values).save(tmp_path / "a.tif", tiffinfo={42113: tag})
    np.testing.assert_array_equal(depth_of(tmp_path / "a.tif"), [[np.nan, 2, np.nan]])


def test_negative_pixels_beside_metres_are_counted(tmp_path: Path) -> None:
    values = np.append(PLANE_M, [[-2, -9999, -1, 0, 1, 1, 1, 1]], 0).astype(np.float32)
    (warning,) = read_stored_depth(write(tmp_path / "a.npy", values)).warnings
    assert warning.endswith("2 pixels from -9999 to -2 are taken as no depth")


def ray_lengths(camera: Intrinsics, centre: tuple[float, float] = (3.5, 2.5)) -> np.ndarray:
    focal_px = camera.focal_for(8, 6)
    assert focal_px
    return np.float32(
        [
            [
                math.hypot(1, (x - centre[0]) / focal_px, (y - centre[1]) / focal_px)
                for x in range(8)
            ]
            for y in range(6)
        ]
    )


@pytest.mark.parametrize("centre_px", [None, (2.0, 4.0)])
def test_distance_along_the_ray(centre_px: tuple[float, float] | None, tmp_path: Path) -> None:
    """Hypersim (apple/ml-hypersim#9), Mitsuba, lidar ranges."""
    camera = Intrinsics(HFOV.focal_for(8, 6), centre_px=centre_px)
    lengths = ray_lengths(camera, centre_px or (3.5, 2.5))
    path = write(tmp_path / "a.npy", 3 * lengths)
    depth_m = depth_of(path, kind=DepthEncoding.DISTANCE, camera=camera)
    np.testing.assert_allclose(depth_m, 3, rtol=1e-6)
    with pytest.raises(InputError):
        depth_of(path, kind=DepthEncoding.DISTANCE)


def test_distance_over_a_data_window(tmp_path: Path) -> None:
    windows = {
        "displayWindow": (np.array([0, 0], np.int32), np.array([7, 5], np.int32)),
        "dataWindow": (np.array([5, 2], np.int32), np.array([7, 5], np.int32)),
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **windows}
    values = np.ascontiguousarray(3 * ray_lengths(HFOV)[2:, 5:])
    OpenEXR.File(header, {"Z": values}).write(str(tmp_path / "a.exr"))
    depth_m = depth_of(tmp_path / "a.exr", kind=DepthEncoding.DISTANCE, camera=HFOV)
    np.testing.assert_allclose(depth_m[2:, 5:], 3, rtol=1e-6)


def test_disparity_has_a_baseline(tmp_path: Path) -> None:
    """KITTI: 256 units per pixel, 721 px, .54 m."""
    steps = np.rint(256 * 721.5 * 0.54 / PLANE_M / 10).astype(np.uint16)
    steps[0, 0] = 0
    options = {"kind": DepthEncoding.DISPARITY, "camera": Intrinsics(721.5), "scale": 256.0}
    path = write(tmp_path / "a.png", steps)
    depth_m = depth_of(path, baseline_m=0.054, **options)
    assert math.isnan(depth_m[0, 0])
    np.testing.assert_allclose(depth_m.ravel()[1:], PLANE_M.ravel()[1:], rtol=1e-3)
    with pytest.raises(InputError):
        depth_of(path, **options)


def test_inverse_depth_is_metric_with_a_scale(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npy", np.append(1 / PLANE_M, np.float32([[0] * 8]), 0))
    relative = read_stored_depth(path, DepthReadOptions(kind=DepthEncoding.INVERSE)).depth
    assert relative.kind is DepthKind.INVERSE
    metric = read_stored_depth(path, DepthReadOptions(1.0, DepthEncoding.INVERSE)).depth
    assert metric.is_metric
    np.testing.assert_allclose(metric.values[:6], PLANE_M, rtol=1e-6)
    assert not metric.valid[6].any()
