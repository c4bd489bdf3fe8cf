"""Normals as other programs read them: 16-bit PNG in the convention of OpenGL."""

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.types import DepthKind, DepthMap, Provenance
from depthcli.errors import OutputError
from depthcli.io.formats.geometry import NormalsWriter
from depthcli.io.formats.table import is_own

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
