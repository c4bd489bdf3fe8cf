"""Normals as other programs read them: 16-bit PNG and EXR in the convention of OpenGL."""

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.types import DepthKind, DepthMap, Frame, Provenance, Window, Windows
from depthcli.errors import OutputError
from depthcli.io.formats.exr import NormalsExrWriter
from depthcli.io.formats.geometry import NormalsWriter
from depthcli.io.guard import is_own

oiio = pytest.importorskip("OpenImageIO")

FOCAL_PX = 50.0
Y, X = np.mgrid[:30, :40]
RAYS = np.stack([(X - 19.5) / FOCAL_PX, (Y - 14.5) / FOCAL_PX, np.ones(X.shape)], -1)


@pytest.mark.parametrize(
    ("plane", "opengl"),  # axes of the camera: x right, y down, z ahead
    [
        ((0, 0, 1), (0, 0, 1)),  # a wall ahead
        ((0, 0.8, 0.6), (0, 0.8, 0.6)),  # a floor, which looks up
        ((0.6, 0, 0.8), (-0.6, 0, 0.8)),  # a wall at the right, which looks to the left
    ],
)
def test_a_plane_has_its_normal(
    plane: tuple[float, ...], opengl: tuple[float, ...], tmp_path: Path
) -> None:
    depth_m = (2 / (RAYS @ plane)).astype(np.float32)
    depth_m[3, 4] = np.nan
    path = tmp_path / "a.normals.png"
    depth = DepthMap(depth_m, provenance=Provenance(focal_px=FOCAL_PX))
    assert NormalsWriter().write(depth, path) == ()
    assert is_own(path)
    stored = oiio.ImageBuf(str(path))
    assert str(stored.spec().format) == "uint16"
    pixels = stored.get_pixels(oiio.FLOAT).astype(float)
    assert (pixels[3, 4] == 0).all()
    normals = np.delete((pixels * 2 - 1).reshape(-1, 3), 3 * 40 + 4, axis=0)
    np.testing.assert_allclose(normals, np.broadcast_to(opengl, normals.shape), atol=1e-3)


def test_depth_without_metres_has_no_normals(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        NormalsWriter().write(
            DepthMap(np.ones((3, 3), np.float32), DepthKind.INVERSE), tmp_path / "a"
        )


@pytest.mark.parametrize("half", [False, True])
def test_exr_normals_are_those_of_the_camera_of_the_display_window(
    half: bool, tmp_path: Path
) -> None:
    display = Window(100, 50, 140, 80)
    data = Window(95, 60, 142, 85)  # overscan at three sides, a crop at the top
    whole = data.union(display)
    y, x = np.mgrid[whole.top : whole.bottom, whole.left : whole.right]
    rays = np.stack([(x - 119.5) / FOCAL_PX, (y - 64.5) / FOCAL_PX, np.ones(x.shape)], -1)
    depth_m = (2 / (rays @ (0.6, 0, 0.8))).astype(np.float32)
    depth_m[20, 7] = np.nan
    depth = DepthMap(depth_m, provenance=Provenance(focal_px=FOCAL_PX))
    frame = Frame(np.zeros(x.shape, np.uint8), windows=Windows(whole, data, display))
    path = tmp_path / "a.normals.exr"
    assert NormalsExrWriter(half=half).write(depth, path, frame) == ()
    assert is_own(path)
    stored = oiio.ImageBuf(str(path))
    spec = stored.spec()
    assert tuple(spec.channelnames) == ("N.X", "N.Y", "N.Z")
    assert (spec.x, spec.y, spec.width, spec.height) == (95, 60, 47, 25)
    assert (spec.full_x, spec.full_y, spec.full_width, spec.full_height) == (100, 50, 40, 30)
    pixels = stored.get_pixels(oiio.FLOAT)
    assert (pixels[10, 7] == 0).all()
    normals = np.delete(pixels.reshape(-1, 3), 10 * 47 + 7, axis=0)
    atol = 1e-3 if half else 1e-4
    np.testing.assert_allclose(normals, np.broadcast_to((-0.6, 0, 0.8), normals.shape), atol=atol)
