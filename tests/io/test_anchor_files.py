"""Known depth in files: what is read, and what is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import made

from depthcli.core.camera import Anchor, Intrinsics
from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError
from depthcli.io.depth.anchors import SELF, AnchorFiles
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer

DEPTH_M = np.full((4, 6), np.nan, np.float32)
DEPTH_M[1, 2], DEPTH_M[3, 5] = 2.5, 4.0


def test_a_table_has_its_columns_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbfname,depth_m,x,y\r\na,2.5,3,4\r\nb,1e1,-0.4,6.6\r\n")
    points = AnchorFiles(str(path)).read()
    assert points.listed() == (Anchor(3, 4, 2.5), Anchor(0, 7, 10.0))
    path.write_bytes(b'x , y, "depth_m"\n3, 4 , 2.5\n 0, 7, "10"\n')
    assert AnchorFiles(str(path)).read().listed() == points.listed()


@pytest.mark.parametrize("text", [b"", b"320,240,2.5\n", b"x,y,metres\n1,2,3\n", b"x,y,depth_m\n"])
def test_a_table_without_columns_or_points_is_refused(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "a.csv").write_bytes(text)
    with pytest.raises(InputError):
        AnchorFiles(str(tmp_path / "a.csv")).read()


@pytest.mark.parametrize("row", [b"1,2", b"1,2,0", b"1,nan,1", b"1,2,\xff", b'1,2,"3'])
def test_an_invalid_row_of_a_table_is_named_by_its_line(tmp_path: Path, row: bytes) -> None:
    (tmp_path / "a.csv").write_bytes(b"x,y,depth_m\n1,2,3\n%s\n" % row)
    with pytest.raises(InputError, match=r"a\.csv, line 3"):
        AnchorFiles(str(tmp_path / "a.csv")).read()


@pytest.mark.parametrize("suffix", ["png", "exr", "npy"])
def test_sparse_map_gives_its_valid_points(tmp_path: Path, suffix: str) -> None:
    path, depth = tmp_path / f"a.{suffix}", DepthMap(DEPTH_M)
    match suffix:
        case "png":
            Png16Writer().write(depth, path)
        case "exr":
            ExrWriter().write(depth, path)
        case _:
            np.save(path, np.nan_to_num(DEPTH_M).astype(np.float64))
    points = AnchorFiles(str(path)).read()
    assert points.size_px == (6, 4)
    assert (points.x.tolist(), points.y.tolist()) == ([2, 5], [1, 3])
    assert points.depth_m == pytest.approx([2.5, 4.0])


def test_maps_of_integers_have_a_scale(tmp_path: Path) -> None:
    steps = np.nan_to_num(DEPTH_M * 256).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), steps)
    np.save(tmp_path / "a.npy", steps)
    for name in ("a.png", "a.npy"):
        points = AnchorFiles(str(tmp_path / name), 256.0).read()
        assert points.depth_m == pytest.approx([2.5, 4.0])
    np.save(tmp_path / "b.npy", steps.astype(np.float32))
    floats = AnchorFiles(str(tmp_path / "b.npy"), 256.0).read()
    assert floats.depth_m == pytest.approx([2.5, 4.0])
    with pytest.raises(InputError):
        AnchorFiles(str(tmp_path / "a.npy")).read()
    with pytest.raises(InputError):
        AnchorFiles(str(tmp_path / "a.csv"), 256.0).read()


def test_distances_along_the_ray_become_depth(tmp_path: Path) -> None:
    camera = Intrinsics(hfov_deg=60)
    focal_px = camera.focal_for(6) or 0
    across, down = (np.arange(6) - 2.5) / focal_px, (np.arange(4) - 1.5) / focal_px
    np.save(tmp_path / "a.npy", 3 * np.sqrt(1 + across**2 + down[:, None] ** 2))
    points = AnchorFiles(str(tmp_path / "a.npy"), None, DepthEncoding.DISTANCE, camera).read()
    assert points.depth_m == pytest.approx(np.full(24, 3.0))
    with pytest.raises(InputError):
        AnchorFiles(str(tmp_path / "a.npy"), None, DepthEncoding.DISTANCE).read()
    np.save(tmp_path / "b.npy", np.full((4, 6), focal_px / 6))
    for baseline_m in (0.5, None):
        files = AnchorFiles(
            str(tmp_path / "b.npy"), None, DepthEncoding.DISPARITY, camera, baseline_m
        )
        if baseline_m:
            assert files.read().depth_m == pytest.approx(np.full(24, 3.0))
        else:
            with pytest.raises(InputError):
                files.read()


def test_a_map_without_metres_is_refused(tmp_path: Path) -> None:
    Png16Writer().write(DepthMap(DEPTH_M, DepthKind.RELATIVE), tmp_path / "a.png")
    np.save(tmp_path / "a.npy", np.zeros((4, 6), np.float32))
    for name in ("a.png", "a.npy", "a.txt", "b.csv"):  # relative, empty, no format, missing
        with pytest.raises(InputError):
            AnchorFiles(str(tmp_path / name)).read()


def test_a_folder_has_a_file_for_each_picture(tmp_path: Path) -> None:
    files = AnchorFiles(str(tmp_path))
    (tmp_path / "hall").mkdir()
    (tmp_path / "hall" / "a.b.csv").write_text("x,y,depth_m\n1,2,3\n")
    assert files.file_for("hall/a.b.jpg") == tmp_path / "hall" / "a.b.csv"
    with pytest.raises(InputError):
        files.file_for("hall/a.jpg")
    np.save(tmp_path / "hall" / "a.b.npy", DEPTH_M)
    with pytest.raises(InputError):
        files.file_for("hall/a.b.jpg")


def test_a_folder_may_be_an_output_of_convert(tmp_path: Path) -> None:
    NpyWriter().write(DepthMap(DEPTH_M), tmp_path / "a.depth.npy")
    files = AnchorFiles(str(tmp_path))
    assert files.file_for("a.jpg") == tmp_path / "a.depth.npy"
    Png16Writer().write(DepthMap(DEPTH_M), tmp_path / "a.depth.png")
    with pytest.raises(InputError):
        files.file_for("a.jpg")
    (tmp_path / "a.csv").write_text("x,y,depth_m\n1,2,3\n")
    assert files.file_for("a.jpg") == tmp_path / "a.csv"


def test_own_depth_of_an_image_is_used_if_it_is_in_metres(tmp_path: Path) -> None:
    path, shades = tmp_path / "a.jpg", np.array([[0, 255]], np.uint8)
    facts = {"Format": "RangeLinear", "Near": "1", "Far": "3"}
    path.write_bytes(made.jpeg_with_depth(made.jpeg([[128]]), shades, Units="m", **facts))
    points = AnchorFiles(SELF).of_image(path)
    assert (points.depth_m.tolist(), points.size_px) == ([1, 3], (2, 1))
    for data in (
        made.jpeg_with_depth(made.jpeg([[128]]), shades, **facts),  # without a unit
        made.jpeg([[128]]),
    ):
        path.write_bytes(data)
        points = AnchorFiles(SELF).of_image(path)
        assert (len(points), len(points.warnings)) == (0, 1)
