"""Which camera the metres of a file belong to, and how it is known."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from depthcli.cli.screen.results import picture_json, picture_text
from depthcli.core.camera import CameraSource, Intrinsics
from depthcli.core.types import DepthMap, Provenance, with_camera
from depthcli.errors import OutputError
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.geometry import PlyWriter
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.sidecar import SidecarWriter
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
