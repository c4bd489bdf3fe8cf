"""Equirectangular panoramas: found in the file, cut into views, and joined without a seam."""

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt
import OpenEXR
import pytest
from helpers.tiny import load, write_model
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from depthcli.core.camera import Intrinsics
from depthcli.core.options import Projection
from depthcli.core.surface import point_cloud
from depthcli.core.types import DepthMap, Frame, Provenance, panorama_rays
from depthcli.errors import InputError, UsageError
from depthcli.inference.panorama import HFOV_DEG, panorama_distance
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.images.read import read_image

EQUIRECTANGULAR = Projection.EQUIRECTANGULAR
XMP = b'<x:xmpmeta><rdf:Description GPano:ProjectionType="equirectangular"/></x:xmpmeta>'


def _norms(side: int) -> npt.NDArray[np.float32]:
    along = np.tan(np.radians(HFOV_DEG) / 2) * ((np.arange(side) + 0.5) * 2 / side - 1)
    return np.sqrt(1 + along**2 + along[:, np.newaxis] ** 2).astype(np.float32)


def test_each_direction_keeps_its_distance() -> None:
    rays = panorama_rays(256, 128)
    distance_m = 3 + rays[..., 0] + rays[..., 1] / 2 + rays[..., 2] / 4
    pixels = (distance_m / 5).astype(np.float32)

    def predict(view: Frame) -> npt.NDArray[np.float32]:
        return np.asarray(view.pixels * 5 / _norms(view.width), np.float32)

    found = panorama_distance(Frame(pixels), predict)
    np.testing.assert_allclose(found, distance_m, rtol=0.02)


def test_views_that_differ_by_a_factor_are_joined_without_a_seam() -> None:
    random = np.random.default_rng(0)

    def predict(view: Frame) -> npt.NDArray[np.float32]:
        return np.float32(2 * random.uniform(0.8, 1.25)) / _norms(view.width)

    found = panorama_distance(Frame(np.zeros((64, 128), np.uint8)), predict)
    edges = np.abs(found[:, 0] / found[:, -1] - 1)
    assert np.median(edges) < 0.02
    assert found.max() / found.min() < 1.02


def test_panorama_that_does_not_show_all_directions_is_refused(tmp_path: Path) -> None:
    pipeline = load(write_model(tmp_path / "m", camera={"hfov_deg": 60.0}))
    whole, part = (
        Frame(np.full((32, width), 90, np.uint8), projection=EQUIRECTANGULAR) for width in (64, 50)
    )
    found = pipeline.predict(whole)
    assert found.depth.values.shape == (32, 64)
    assert found.depth.provenance.focal_px is None
    for frame, camera in ((part, Intrinsics()), (whole, Intrinsics(hfov_deg=60.0))):
        with pytest.raises(InputError):
            pipeline.predict(frame, camera)
    with pytest.raises(InputError):
        load(write_model(tmp_path / "n", camera=None)).predict(whole)


def test_point_cloud_of_a_panorama_is_along_its_rays(tmp_path: Path) -> None:
    source = Provenance(projection=EQUIRECTANGULAR)
    ExrWriter().write(
        DepthMap(np.full((8, 16), 2, np.float32), provenance=source), tmp_path / "a.exr"
    )
    depth = read_stored_depth(tmp_path / "a.exr").displayed
    xyz_m = point_cloud(depth, 1.0).xyz_m
    np.testing.assert_allclose(np.linalg.norm(xyz_m, axis=1), 2, rtol=1e-5)
    top, middle, right = xyz_m[8], xyz_m[3 * 16 + 8], xyz_m[4 * 16 + 12]
    assert (top[1], middle[2], right[0]) == pytest.approx((-2, 2, 2), abs=0.1)


@pytest.mark.parametrize("name", ["jpg", "png", "exr"])
def test_panorama_that_is_read_as_a_pinhole_image_is_a_warning(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"a.{name}"
    pixels = np.full((32, 64, 3), 90, np.uint8)
    if name == "exr":
        header = {"envmap": OpenEXR.ENVMAP_LATLONG}
        OpenEXR.File(header, {"RGB": (pixels / 255).astype(np.float16)}).write(str(path))
    elif name == "jpg":
        Image.fromarray(pixels).save(path, xmp=XMP)
    else:
        data = io.BytesIO()
        info = PngInfo()
        info.add_itxt("XML:com.adobe.xmp", XMP.decode())
        Image.fromarray(pixels).save(data, "png", pnginfo=info)
        path.write_bytes(data.getvalue())
    assert ["panorama" in text for text in read_image(path).warnings] == [True]
    for projection in ("pinhole", "equirectangular"):  # as they are written in Python
        frame = read_image(path, projection=projection)  # type: ignore[arg-type]
        assert isinstance(frame.projection, Projection)
        assert (frame.warnings, frame.projection) == ((), projection)


def test_unknown_projection_is_a_usage_error() -> None:
    with pytest.raises(UsageError):
        Frame(np.zeros((4, 8), np.uint8), projection="fisheye")  # type: ignore[arg-type]


def test_panorama_that_was_cropped_is_refused(tmp_path: Path) -> None:
    of = (b"FullPanoWidthPixels", b"64"), (b"CroppedAreaImageWidthPixels", b"32")
    facts = b" ".join(b'GPano:%s="%s"' % pair for pair in of)
    xmp = XMP.replace(b"/>", b" " + facts + b"/>")
    Image.new("L", (32, 16)).save(tmp_path / "a.webp", xmp=xmp)
    assert read_image(tmp_path / "a.webp").warnings
    with pytest.raises(InputError, match=r"a\.webp"):
        read_image(tmp_path / "a.webp", projection=EQUIRECTANGULAR)
