"""What files and their sidecars state of camera, time and unit."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest

import depthcli
from depthcli.cli.screen.results import picture_json, picture_text
from depthcli.core.camera import CameraSource, Intrinsics
from depthcli.core.options import DepthEncoding
from depthcli.core.types import AnchorFit, DepthKind, DepthMap, Provenance, with_camera
from depthcli.errors import OutputError
from depthcli.io.depth.read import DepthReadOptions, StoredDepth, read_metadata, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.geometry import PlyWriter
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.io.formats.table import FORMATS, Format, writer_class
from depthcli.io.images.png import encode_png
from depthcli.jobs.predict import PictureResult

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
    [(Png16Writer(), "a.png"), (ExrWriter(), "a.exr"), (NpyWriter(), "a.npy")],
    ids=["png", "exr", "npy"],
)
@pytest.mark.parametrize("source", WORDS)
def test_a_file_says_which_camera(
    tmp_path: Path,
    writer: Png16Writer | ExrWriter | NpyWriter,
    name: str,
    source: CameraSource | None,
) -> None:
    path = tmp_path / name
    writer.write(seen_by(source), path)
    if isinstance(writer, NpyWriter):  # which has no room for words
        SidecarWriter().write(seen_by(source), path.with_suffix(".json"))
    assert read_metadata(path)["camera"] == WORDS[source]
    found = read_stored_depth(path).displayed.provenance
    assert found is not None
    assert (found.focal_px, found.camera_source) == (2, source)


@pytest.mark.parametrize("source", WORDS)
def test_predict_says_which_camera(source: CameraSource | None) -> None:
    done = PictureResult("a.jpg", ("a.png",), seen_by(source), "cpu", 0.1, ())
    assert picture_text(done).endswith(f"max 1.000 m  camera: {WORDS[source]}")
    facts = json.loads(json.dumps(picture_json(done)))
    assert (facts["focal_px"], facts["camera_source"]) == (2, source)
    assert facts["camera"] == WORDS[source]


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
    found = stored.displayed.provenance
    assert found is not None
    assert found.focal_px == pytest.approx(55.4256 / 4)
    assert found.centre_px == pytest.approx((9.625, 4.625))
    assert stored.metadata["camera"] == "hfov 60.0° (given)"
    assert ["64×48" in text and "16×12" in text for text in stored.warnings] == [True]
    PlyWriter().write(stored.displayed, tmp_path / "a.ply")


def test_focal_length_of_cropped_depth_is_refused(tmp_path: Path) -> None:
    original = _wide(tmp_path)
    assert read_stored_depth(original).warnings == ()
    path = _changed_by_another_program(original, slice(0, 20), slice(10, 50))
    stored = read_stored_depth(path)
    found = stored.displayed.provenance
    assert found is not None
    assert (found.focal_px, found.centre_px, found.is_cropped) == (None, None, True)
    assert not {"camera", "focal_px"} & set(stored.metadata)
    assert ["64" in text and "40×20" in text for text in stored.warnings] == [True]
    with pytest.raises(OutputError):
        PlyWriter().write(stored.displayed, tmp_path / "a.ply")
    given = with_camera(stored.displayed, Intrinsics(focal_px=50.0))
    PlyWriter().write(given, tmp_path / "a.ply")
    assert given.provenance is not None
    assert given.provenance.focal_px == 50


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
