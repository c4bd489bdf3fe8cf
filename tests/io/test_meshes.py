"""PLY and GLB as an independent library reads them."""

import json
import math
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from depthcli._version import __version__
from depthcli.core.camera import CameraSource, hfov_deg
from depthcli.core.surface import surface_of
from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.errors import OutputError, UsageError
from depthcli.io.formats.geometry import camera_of
from depthcli.io.formats.table import Format, WriterOptions, writer_of
from depthcli.io.guard import is_own

trimesh = pytest.importorskip("trimesh")

FOCAL_PX = 40.0
HEIGHT, WIDTH = 24, 32
SOURCE = Provenance(model="room", focal_px=FOCAL_PX)
PIXELS = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def box_before_wall() -> DepthMap:
    """A slanted box at about 1 m before a wall at 3 m, with a hole in the wall."""
    depth_m = np.full((HEIGHT, WIDTH), 3, np.float32)
    depth_m[8:16, 10:20] = np.linspace(1, 1.1, 10, dtype=np.float32)
    depth_m[2, 3] = np.nan
    return DepthMap(depth_m, provenance=SOURCE)


def written(path: Path, depth: DepthMap, frame: Frame | None = None, **options: Any) -> Any:
    """A mesh or cloud as trimesh reads it, with its points as they are in the file."""
    format_ = Format(path.suffix[1:])
    writer_of(format_, WriterOptions(**options)).write(depth, path, frame)
    assert is_own(path)
    return trimesh.load(path, process=False, force="mesh" if format_ is Format.GLB else None)


def test_a_glb_is_a_mesh_in_metres_with_y_up(tmp_path: Path) -> None:
    depth = box_before_wall()
    mesh = written(tmp_path / "a.glb", depth, Frame(PIXELS))
    surface = surface_of(depth, FOCAL_PX)
    points_m, faces = surface.xyz_m[surface.valid] * [1, -1, -1], surface.faces()
    np.testing.assert_array_equal(mesh.vertices[: len(points_m)], points_m)
    np.testing.assert_array_equal(mesh.faces[: len(faces)], faces)
    assert (mesh.face_normals[:, 2] > 0).all()  # towards the camera
    edges_m = np.ptp(mesh.vertices[mesh.faces][..., 2], axis=1)
    assert edges_m.max() < 0.1  # no curtain between box and wall


@pytest.mark.parametrize("smear", [1, 5])
@pytest.mark.parametrize("keep_edges", [False, True])
def test_the_camera_sees_no_outline(smear: int, tmp_path: Path, *, keep_edges: bool) -> None:
    values = cv2.blur(np.nan_to_num(box_before_wall().values, nan=3), (smear, smear))
    mesh = written(tmp_path / "a.glb", DepthMap(values, provenance=SOURCE), keep_edges=keep_edges)
    projected = mesh.vertices[:, :2] / -mesh.vertices[:, 2:] * [1, -1] * FOCAL_PX
    pixels = np.rint(8 * (projected + np.array([WIDTH - 1, HEIGHT - 1]) / 2)).astype(np.int32)
    covered = np.zeros((8 * (HEIGHT - 1), 8 * (WIDTH - 1)), np.uint8)
    for corners in pixels[mesh.faces]:
        cv2.fillConvexPoly(covered, corners, 1)
    assert covered.all()
    if keep_edges:
        assert (len(mesh.vertices), len(mesh.faces)) == (
            values.size,
            2 * (HEIGHT - 1) * (WIDTH - 1),
        )


def test_writing_a_mesh_takes_a_few_times_its_size(tmp_path: Path) -> None:
    # A photograph of 12 megapixels took 2.3 GB, more than a worker has in docs/scaling.md.
    depth = DepthMap(np.linspace(1, 2, 400 * 500, dtype=np.float32).reshape(400, 500))
    tracemalloc.start()
    writer_of(Format.GLB, WriterOptions()).write(depth, tmp_path / "a.glb")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3.2 * (tmp_path / "a.glb").stat().st_size


def test_the_image_is_on_the_mesh(tmp_path: Path) -> None:
    smooth = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    smooth[..., 0], smooth[..., 1] = np.arange(WIDTH) * 8, np.arange(HEIGHT)[:, None] * 10
    depth = box_before_wall()
    mesh = written(tmp_path / "a.glb", depth, Frame(smooth), stride=2)
    expected = smooth[::2, ::2][surface_of(depth, FOCAL_PX, stride=2).valid]
    colours = mesh.visual.material.to_color(mesh.visual.uv)[: len(expected), :3]
    assert abs(colours.astype(int) - expected).max() < 16  # JPEG


def test_a_glb_states_its_metadata_and_lengths(tmp_path: Path) -> None:
    wide = Provenance(model="room", focal_px=FOCAL_PX, pixel_aspect=2.0)
    depth = DepthMap(box_before_wall().values, provenance=wide)
    written(tmp_path / "a.glb", depth)
    data = (tmp_path / "a.glb").read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + size])
    assert document["nodes"][0]["extras"]["model"] == "room"
    assert not set(document) & {"images", "textures"}
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    assert [node["name"] for node in document["nodes"]] == ["depth", "camera"]
    view = document["cameras"][0]["perspective"]
    assert math.tan(view["yfov"] / 2) == pytest.approx(HEIGHT / 2 / (2 * FOCAL_PX))
    assert view["aspectRatio"] == 2 * WIDTH / HEIGHT


def test_a_texture_is_at_most_8192_pixels_wide_and_named_as_the_image(tmp_path: Path) -> None:
    """rerun-io/rerun#3337, CesiumGS/cesium#5416: graphics cards take no larger ones."""
    frame = Frame(np.zeros((2, 9000), np.uint8), tmp_path / "hall.jpg")
    depth = DepthMap(np.ones((2, 9000), np.float32), provenance=SOURCE)
    scene = trimesh.load(written(tmp_path / "a.glb", depth, frame) and tmp_path / "a.glb")
    (mesh,) = scene.geometry.values()
    assert mesh.visual.material.baseColorTexture.size == (8192, 2)
    assert (list(scene.geometry), mesh.visual.material.name) == (["hall"], "hall")


def test_a_usdz_is_the_mesh_of_the_glb_with_the_image_on_it(tmp_path: Path) -> None:
    pxr, validation = pytest.importorskip("pxr"), pytest.importorskip("pxr.UsdValidation")
    depth, path = box_before_wall(), tmp_path / "a.usdz"
    mesh = written(tmp_path / "a.glb", depth, Frame(PIXELS), stride=2)
    writer_of(Format.USDZ, WriterOptions(stride=2)).write(depth, path, Frame(PIXELS))
    assert is_own(path)
    stage = pxr.Usd.Stage.Open(str(path))
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    assert not validation.ValidationContext(validators).Validate(stage)
    assert pxr.UsdGeom.GetStageUpAxis(stage) == "Y"
    assert pxr.UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert stage.GetRootLayer().customLayerData["model"] == "room"
    prim = stage.GetDefaultPrim().GetChild("mesh")
    names = ("points", "faceVertexIndices", "faceVertexCounts", "primvars:st")
    values = {name: np.array(prim.GetAttribute(name).Get()) for name in names}
    np.testing.assert_array_equal(values["points"], np.float32(mesh.vertices))
    np.testing.assert_array_equal(values["faceVertexIndices"].reshape(-1, 3), mesh.faces)
    assert (values["faceVertexCounts"] == 3).all()
    np.testing.assert_allclose(values["primvars:st"], mesh.visual.uv, atol=1e-6)
    with zipfile.ZipFile(path) as archive:
        facts = [(file.filename, file.date_time[0]) for file in archive.infolist()]
    assert facts == [("depthcli.usdc", 1985), ("depthcli.jpg", 1985)]  # the same in every run
    material = pxr.UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    source = material.ComputeSurfaceSource()[0].GetInput("emissiveColor").GetConnectedSource()
    assert source[0].GetPrim().GetAttribute("inputs:file").Get().path == "depthcli.jpg"


def test_a_ply_has_normals_and_faces(tmp_path: Path) -> None:
    depth = box_before_wall()
    mesh = written(tmp_path / "a.ply", depth, Frame(PIXELS), faces=True)
    surface = surface_of(depth, FOCAL_PX)
    np.testing.assert_array_equal(mesh.vertices, surface.xyz_m[surface.valid])
    np.testing.assert_array_equal(mesh.faces, surface.faces())
    np.testing.assert_allclose(mesh.vertex_normals, surface.normals()[surface.valid], atol=1e-6)
    np.testing.assert_array_equal(mesh.visual.vertex_colors[:, :3], PIXELS[surface.valid])
    cloud = written(tmp_path / "b.ply", depth, Frame(PIXELS), stride=3, max_depth_m=2.0)
    thin = surface_of(depth, FOCAL_PX, stride=3, max_depth_m=2)
    np.testing.assert_array_equal(cloud.vertices, thin.xyz_m[thin.valid])
    np.testing.assert_array_equal(cloud.colors[:, :3], PIXELS[::3, ::3][thin.valid])


def test_a_file_without_points_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        written(tmp_path / "a.glb", box_before_wall(), max_depth_m=0.5)
    with pytest.raises(UsageError):
        WriterOptions(stride=0)
    assert not list(tmp_path.iterdir())


DEPTH_M = np.array([[1, 2, 3, 4], [5, np.nan, 0, 8]], np.float32)


@pytest.mark.parametrize(("size", "hfov"), [((640, 360), 63.3), ((60, 60), 49.6), ((3, 4), 49.6)])
def test_assumed_camera_is_that_of_predict(size: tuple[int, int], hfov: float) -> None:
    """The largest crop of NYU's, so that NPY in between changes no mesh."""
    focal_px, warnings = camera_of(DepthMap(np.ones(size[::-1], np.float32)))
    assert hfov_deg(focal_px, size[0]) == pytest.approx(hfov, abs=0.05)
    assert len(warnings) == 1


def test_header_of_a_ply_states_types_software_model_and_camera(tmp_path: Path) -> None:
    source = Provenance(model="室\nend_header\n", focal_px=519.5, camera_source=CameraSource.EXIF)
    written(tmp_path / "a.ply", DepthMap(DEPTH_M, provenance=source), keep_edges=True)
    header = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[0].decode("ascii")
    assert header.splitlines() == [
        "ply",
        "format binary_little_endian 1.0",
        "comment depthcli:kind metric",
        "comment depthcli:unit m",
        f"comment depthcli:software depthcli {__version__}",
        r"comment depthcli:model \u5ba4\nend_header\n",
        "comment depthcli:focal_px 519.5",
        "comment depthcli:camera_source exif",
        "element vertex 6",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
    ]
