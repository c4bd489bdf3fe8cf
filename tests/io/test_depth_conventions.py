"""What the numbers in a depth file mean: unit, sign, background, distance and disparity."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest

from depthcli.core.camera import Intrinsics
from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError
from depthcli.io.depth.metadata import DepthScale
from depthcli.io.depth.read import DepthReadOptions, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.jobs.convert import ConvertRequest, convert

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


def depth_of(path: Path, **stated: Any) -> np.ndarray:
    return read_stored_depth(path, DepthReadOptions(**stated)).displayed.values


@pytest.mark.parametrize("name", ["a.exr", "a.npy"])
@pytest.mark.parametrize("units_per_metre", [100, 1000])
def test_floats_have_a_unit(name: str, units_per_metre: float, tmp_path: Path) -> None:
    """Unreal writes centimetres (PerceivingSystems/bedlam_render#14), Ensenso millimetres."""
    path = write(tmp_path / name, PLANE_M * np.float32(units_per_metre))
    assumed = read_stored_depth(path)
    assert assumed.scale == DepthScale(1.0, "assumed")
    assert len(assumed.warnings_with_scale("from_scale")) == 1  # hardly metres
    for stated in ({"scale": units_per_metre}, {"unstated_scale": units_per_metre}):
        np.testing.assert_allclose(depth_of(path, **stated), PLANE_M, rtol=1e-6)


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
    found = read_stored_depth(write(tmp_path / "stereo.exr", PLANE_M, "disparity.R"))
    assert found.depth.kind is DepthKind.INVERSE


def test_metres_in_floats_need_no_warning(tmp_path: Path) -> None:
    assert not read_stored_depth(write(tmp_path / "a.npy", PLANE_M)).warnings_with_scale("scale")
    ExrWriter().write(DepthMap(PLANE_M), tmp_path / "own.exr")
    own = read_stored_depth(tmp_path / "own.exr", DepthReadOptions(unstated_scale=1000))
    assert own.scale == DepthScale(1.0, "file")
    np.testing.assert_array_equal(own.depth.values, PLANE_M)


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
    assert done.round_trip.lost == 47


def ray_lengths(camera: Intrinsics, centre: tuple[float, float] = (3.5, 2.5)) -> np.ndarray:
    focal_px = camera.focal_for(8)
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
    camera = Intrinsics(HFOV.focal_for(8), centre_px=centre_px)
    lengths = ray_lengths(camera, centre_px or (3.5, 2.5))
    path = write(tmp_path / "a.npy", 3 * lengths)
    found = depth_of(path, kind=DepthEncoding.DISTANCE, camera=camera)
    np.testing.assert_allclose(found, 3, rtol=1e-6)
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
    found = depth_of(tmp_path / "a.exr", kind=DepthEncoding.DISTANCE, camera=HFOV)
    np.testing.assert_allclose(found[2:, 5:], 3, rtol=1e-6)


def test_disparity_has_a_baseline(tmp_path: Path) -> None:
    """KITTI: 256 units per pixel, 721 px, .54 m."""
    steps = np.rint(256 * 721.5 * 0.54 / PLANE_M / 10).astype(np.uint16)
    steps[0, 0] = 0
    stated = {"kind": DepthEncoding.DISPARITY, "camera": Intrinsics(721.5), "scale": 256.0}
    path = write(tmp_path / "a.png", steps)
    found = depth_of(path, baseline_m=0.054, **stated)
    assert math.isnan(found[0, 0])
    np.testing.assert_allclose(found.ravel()[1:], PLANE_M.ravel()[1:], rtol=1e-3)
    with pytest.raises(InputError):
        depth_of(path, **stated)


def test_inverse_depth_is_metric_with_a_scale(tmp_path: Path) -> None:
    path = write(tmp_path / "a.npy", np.append(1 / PLANE_M, np.float32([[0] * 8]), 0))
    relative = read_stored_depth(path, DepthReadOptions(kind=DepthEncoding.INVERSE)).depth
    assert relative.kind is DepthKind.INVERSE
    found = read_stored_depth(path, DepthReadOptions(1.0, DepthEncoding.INVERSE)).depth
    assert found.is_metric
    np.testing.assert_allclose(found.values[:6], PLANE_M, rtol=1e-6)
    assert not found.valid[6].any()
