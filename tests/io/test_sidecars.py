"""Sidecars beside depth files: whose they are, and what they add."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest

import depthcli
from depthcli.core.camera import CameraSource
from depthcli.core.options import DepthEncoding
from depthcli.core.types import AnchorFit, DepthKind, DepthMap, Provenance
from depthcli.io.depth.read import DepthReadOptions, StoredDepth, read_metadata, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.io.formats.table import FORMATS, Format, writer_class
from depthcli.io.images.png import encode_png

DEPTH_M = np.linspace(0.5, 9, 12, dtype=np.float32).reshape(3, 4)
STATED = Provenance("m", "ab" * 32, focal_px=3.0, orientation=6, camera_source=CameraSource.OPTION)
DEPTH = DepthMap(DEPTH_M, provenance=STATED)
RELATIVE = DepthReadOptions(kind=DepthEncoding.RELATIVE)


def write_steps(path: Path, steps: np.ndarray) -> None:
    """A 16-bit PNG without texts."""
    path.write_bytes(encode_png(steps.astype(np.uint16), {}))


def write_map(path: Path, values: np.ndarray) -> None:
    """A map in a file without metadata."""
    match path.suffix:
        case ".png":
            write_steps(path, values * 1000)
        case ".exr":
            OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": values}).write(str(path))
        case _:
            np.save(path, values)


def is_used(stored: StoredDepth) -> bool:
    """Whether a sidecar adds its facts; if not, a warning names it."""
    if stored.depth.provenance is not None and stored.depth.provenance.orientation == 6:
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
        write_map(path, np.ascontiguousarray(values))
        stored = read_stored_depth(path)
        assert is_used(stored) is expected
        assert ("focal_px" in read_metadata(path)) is expected
        assert (stored.depth.provenance is not None) is expected


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
    Png16Writer(**options).write(depth, path)  # type: ignore[arg-type]
    SidecarWriter(**options).write(depth, tmp_path / "a.json")  # type: ignore[arg-type]
    before = read_stored_depth(path)
    write_steps(path, cv2.imread(str(path), cv2.IMREAD_UNCHANGED))  # type: ignore[arg-type]
    after = read_stored_depth(path)
    assert (after.scale, after.depth.kind) == (before.scale, kind)
    np.testing.assert_allclose(after.depth.values, before.depth.values, rtol=1e-6)
    np.testing.assert_allclose(after.depth.values, DEPTH_M, atol=0.003)


def test_frame_has_the_scale_of_the_video_sidecar(tmp_path: Path) -> None:
    path = tmp_path / "a.depth.000007.png"
    write_steps(path, DEPTH_M * 256)
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


FIT = AnchorFit(1_234_567, 2_000_000, 0.012346)
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
    for depth, expected in ((FITTED, "1234567,2000000,0.012346"), (DEPTH, None)):
        writer.write(depth, path)
        assert read_metadata(path).get("anchors") == expected
        assert depthcli.read_depth(path).anchor_fit == (expected and FIT)
    # The fit in the sidecar of an earlier run is not that of the map.
    SidecarWriter().write(FITTED, tmp_path / "a.json")
    assert not is_used(read_stored_depth(path))
