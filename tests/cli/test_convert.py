"""``depthcli convert``: the camera of point clouds, and what a file's name says."""

import json
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.tiny import write_picture

from depthcli.core.types import DepthMap, Provenance
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.sidecar import SidecarWriter

DEPTH = DepthMap(np.full((6, 8), 2, np.float32), provenance=Provenance("m", "0" * 64, (4, 3), 16.0))


def points_m(path: Path) -> np.ndarray:
    """The points of a cloud, (N, 3) float32."""
    body = path.read_bytes().partition(b"end_header\n")[2]
    return np.frombuffer(body, [("xyz_m", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])[
        "xyz_m"
    ]


def width_m(path: Path) -> float:
    """From the leftmost to the rightmost point."""
    return float(np.ptp(points_m(path)[:, 0]))


@pytest.fixture
def files(inside: Cli) -> Path:
    """One map, which states a focal length of 16 pixels, in every format that is read."""
    Png16Writer().write(DEPTH, inside.folder / "d.png")
    ExrWriter().write(DEPTH, inside.folder / "e.exr")
    NpyWriter().write(DEPTH, inside.folder / "n.npy")
    SidecarWriter().write(DEPTH, inside.folder / "n.json")
    NpyWriter().write(DEPTH, inside.folder / "bare.npy")
    return inside.folder


@pytest.mark.parametrize("name", ["d.png", "e.exr", "n.npy"])
def test_a_cloud_has_the_camera_that_its_input_states(inside: Cli, files: Path, name: str) -> None:
    done = inside("convert", name, "a.ply")
    assert (done.returncode, done.stderr) == (0, b"")
    assert width_m(files / "a.ply") == pytest.approx(7 / 16 * 2, rel=1e-5)


@pytest.mark.parametrize(
    ("options", "focal_px"), [(("--focal-px", "40"), 40), (("--hfov", "90"), 4)]
)
@pytest.mark.parametrize("name", ["d.png", "bare.npy"])
def test_camera_options_override_the_stated_camera(
    inside: Cli, files: Path, name: str, options: tuple[str, str], focal_px: float
) -> None:
    done = inside("convert", name, "a.ply", *options)
    assert (done.returncode, done.stderr) == (0, b"")
    assert width_m(files / "a.ply") == pytest.approx(7 / focal_px * 2, rel=1e-5)


def test_a_picture_gives_the_points_their_colours(inside: Cli, files: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    write_picture(files / "room.png", pixels)
    assert inside("convert", "d.png", "a.ply", "--picture", "room.png").returncode == 0
    body = (files / "a.ply").read_bytes().partition(b"end_header\n")[2]
    colours = np.frombuffer(body, np.uint8).reshape(-1, 27)[:, 24:]
    read = cv2.imread(str(files / "room.png"))
    np.testing.assert_array_equal(colours, read[..., ::-1].reshape(-1, 3))
    write_picture(files / "other.png", pixels[:5])
    assert inside("convert", "d.png", "b.ply", "--picture", "other.png").returncode == 1
    assert inside("convert", "d.png", "room.png", "--picture", "room.png").returncode == 1


def test_a_preview_of_stored_depth_is_that_of_predict(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    options = ("--vmin", "0.5", "--vmax", "6", "--near", "white", "--legend", "--side-by-side")
    assert inside("predict", "room.png", "-o", "d.npy").returncode == 0
    assert inside("predict", "room.png", "-o", "p.preview.png", *options).returncode == 0
    command = ("convert", "d.npy", "c.preview.png", *options)
    assert inside(*command, "--picture", "room.png").returncode == 0
    predicted, converted = (
        cv2.imread(str(inside.folder / f"{name}.preview.png")) for name in ("p", "c")
    )
    np.testing.assert_array_equal(converted, predicted)
    assert inside(*command).returncode == 2


@pytest.mark.parametrize("target", ["b.png", "b.exr"])
def test_a_conversion_keeps_model_and_focal_length(inside: Cli, files: Path, target: str) -> None:
    assert inside("convert", "n.npy", target).returncode == 0
    made_by = read_stored_depth(files / target).displayed.provenance
    assert (made_by.model, made_by.model_sha256, made_by.focal_px) == ("m", "0" * 64, 16.0)
    assert inside("convert", "d.png", "b.json", "--png-scale", "256").returncode == 0
    told = json.loads((files / "b.json").read_text())
    assert (told["focal_px"], told["model"], told["png16_scale"]) == (16.0, "m", 256)


CALIBRATION = """image_width: 16
image_height: 12
camera_matrix: {rows: 3, cols: 3, data: [40, 0, 6.5, 0, 40, 4.5, 0, 0, 1]}
distortion_model: equidistant
distortion_coefficients: {rows: 1, cols: 4, data: [0.1, 0, 0, 0]}
projection_matrix: {rows: 3, cols: 4, data: [32, 0, 7.5, 0, 0, 32, 5.5, 0, 0, 0, 1, 0]}
"""
CAMERAS = [
    (("--focal-px", "40"), 40, None),
    (("--hfov", "90", "--centre-px", "3,2"), 4, (3, 2)),
    (("--calibration", "camera.yaml"), 20, (3, 2)),
    (("--calibration", "camera.yaml", "--rectified"), 16, (3.5, 2.5)),
]


@pytest.mark.parametrize(("options", "focal_px", "centre_px"), CAMERAS)
@pytest.mark.parametrize("name", ["b.png", "b.exr", "b.json"])
def test_a_file_states_the_given_camera(
    inside: Cli,
    files: Path,
    name: str,
    options: tuple[str, ...],
    focal_px: float,
    centre_px: tuple[float, float] | None,
) -> None:
    (files / "camera.yaml").write_text(CALIBRATION)
    done = inside("convert", "bare.npy", name, *options)
    assert done.returncode == 0
    if name == "b.json":
        told = json.loads((files / name).read_text())
        told["centre_px"] = told["centre_px"] and tuple(told["centre_px"])
    else:
        depth = read_stored_depth(files / name).displayed
        told = asdict(depth.provenance or Provenance())
        np.testing.assert_array_equal(depth.values, DEPTH.values)
    assert told["focal_px"] == pytest.approx(focal_px)
    assert (told["centre_px"], told["camera_source"]) == (centre_px, "option")


@pytest.mark.parametrize(("options", "focal_px", "centre_px"), CAMERAS)
def test_a_cloud_has_the_given_camera(
    inside: Cli,
    files: Path,
    options: tuple[str, ...],
    focal_px: float,
    centre_px: tuple[float, float] | None,
) -> None:
    (files / "camera.yaml").write_text(CALIBRATION)
    assert inside("convert", ".", "--out", "clouds", "--format", "ply", *options).returncode == 0
    x, y = centre_px or (3.5, 2.5)
    for name in ("d", "bare"):
        first_m = points_m(files / "clouds" / f"{name}.ply")[0]
        assert first_m == pytest.approx([-x * 2 / focal_px, -y * 2 / focal_px, 2], rel=1e-5)


def test_a_calibration_warns_and_is_not_replaced(inside: Cli, files: Path) -> None:
    (files / "camera.yaml").write_text(CALIBRATION)
    command = ("convert", "d.png", "b.exr", "--calibration", "camera.yaml")
    assert inside(*command).stderr.startswith(b"depthcli: warning: ")
    assert not inside(*command, "--rectified").stderr + inside(*command, "--quiet").stderr
    (files / "camera.json").write_text(CALIBRATION)
    done = inside("convert", "d.png", "camera.json", "--calibration", "camera.json")
    assert done.returncode == 1
    assert (files / "camera.json").read_text() == CALIBRATION
    ExrWriter().write(DepthMap(np.ones((6, 12), np.float32)), files / "wide.exr")
    assert inside("convert", "wide.exr", "b.ply", *command[-2:]).returncode == 1


def test_the_sidecar_of_a_png_states_its_scale(inside: Cli) -> None:
    steps = np.full((6, 8), 2560, np.uint16)
    steps[0] = 0  # no depth
    cv2.imwrite(str(inside.folder / "kitti.png"), steps)
    assert inside("convert", "kitti.png", "kitti.json", "--from-scale", "256").returncode == 0
    assert json.loads((inside.folder / "kitti.json").read_text())["png16_scale"] == 256
    assert np.nanmax(read_stored_depth(inside.folder / "kitti.png").displayed.values) == 10
    Png16Writer(png_normalize=True).write(DEPTH, inside.folder / "d.png")
    assert inside("convert", "d.png", "d", "--format", "json").returncode == 0
    (sidecar,) = inside.folder.glob("d*.json")
    assert json.loads(sidecar.read_text())["png16_scale"] is None


@pytest.mark.parametrize("between", ["a.exr", "a.png", "a.npy"])
def test_a_cloud_has_the_shape_of_pixels_that_are_not_square(inside: Cli, between: str) -> None:
    source = Provenance(focal_px=5.0, pixel_aspect=2.0)
    wide = DepthMap(np.full((6, 8), 2, np.float32), provenance=source)
    ExrWriter().write(wide, inside.folder / "wide.exr")
    assert inside("convert", "wide.exr", between).returncode == 0
    if between == "a.npy":
        assert inside("convert", "wide.exr", "a.json").returncode == 0
    done = inside("convert", between, "wide.ply")
    assert (done.returncode, done.stderr) == (0, b"")
    xyz_m = points_m(inside.folder / "wide.ply")
    np.testing.assert_allclose(xyz_m.max(0), [3.5 / 5 * 2, 2.5 / 10 * 2, 2], rtol=1e-6)
