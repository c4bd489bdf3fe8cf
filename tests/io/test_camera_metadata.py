"""Which camera the metres of a file belong to, and how it is known."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from depthcli.cli.screen.results import picture_json, picture_text
from depthcli.core.camera import CameraSource
from depthcli.core.types import DepthMap, Provenance
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.sidecar import SidecarWriter
from depthcli.jobs.predict import PictureResult

if TYPE_CHECKING:
    from pathlib import Path

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


def test_a_source_that_another_program_wrote_is_no_source(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Png16Writer().write(seen_by(CameraSource.EXIF), path)
    path.write_bytes(path.read_bytes().replace(b"_source\0exif", b"_source\0moon"))
    found = read_stored_depth(path).displayed.provenance
    assert found is not None
    assert (found.focal_px, found.camera_source) == (2, None)
