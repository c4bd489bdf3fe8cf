"""Of a file with several pictures the first is used, and the user is told of the others."""

from __future__ import annotations

import json
from io import BytesIO
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from helpers.tiny import write_model
from PIL import Image

from depthcli.inference.loading import SessionLoader
from depthcli.io.images.read import read_image
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.predict import PredictRequest, picture_destination, predict

if TYPE_CHECKING:
    from pathlib import Path

TOLD = ("has 3 pictures; only the first is used",)
PICTURES = list(np.random.default_rng(0).integers(0, 255, (3, 40, 60, 3), np.uint8))


def saved(kind: str, count: int, **options: Any) -> bytes:
    first, *others = map(Image.fromarray, PICTURES[:count])
    file = BytesIO()
    first.save(file, kind, save_all=True, append_images=others, **options)
    return file.getvalue()


@pytest.mark.parametrize("options", [{}, {"compression": "tiff_lzw"}, {"big_tiff": True}])
def test_other_pages_of_a_tiff_are_told(options: dict[str, Any]) -> None:
    assert read_image(None, saved("TIFF", 3, **options)).warnings == TOLD
    assert read_image(None, saved("TIFF", 1, **options)).warnings == ()
    ok, data = cv2.imencodemulti(".tiff", PICTURES)
    assert ok
    assert read_image(None, data.tobytes()).warnings == TOLD


def test_thumbnails_and_masks_are_no_other_pictures() -> None:
    first, *others = map(Image.fromarray, PICTURES)
    for kind, count in ((1, 1), (4, 1), (2, 3)):
        for other in others:
            other.encoderinfo = {"tiffinfo": {254: kind}}
        file = BytesIO()
        first.save(file, "TIFF", save_all=True, append_images=others)
        assert len(read_image(None, file.getvalue()).warnings) == (count > 1)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("GIF", {"duration": 100, "loop": 0}),
        ("PNG", {}),
        ("PNG", {"default_image": True}),
        ("WEBP", {}),
        ("WEBP", {"lossless": True, "exif": b"Exif\0\0II*\0"}),
        ("AVIF", {}),
    ],
)
def test_animation_is_told(kind: str, options: dict[str, Any]) -> None:
    (warning,) = read_image(None, saved(kind, 3, **options)).warnings
    assert "animated" in warning
    assert read_image(None, saved(kind, 1)).warnings == ()


def test_it_is_a_warning_of_the_picture(tmp_path: Path) -> None:
    source = tmp_path / "in" / "a.tiff"
    source.parent.mkdir()
    source.write_bytes(saved("TIFF", 3))
    loader = SessionLoader(write_model(tmp_path / "model"), "cpu")
    (result,) = predict(
        PredictRequest((str(source),), picture_destination(f"{tmp_path / 'one'}/"), model=loader)
    )
    assert result.warnings == TOLD
    plan = plan_folder(str(source.parent), str(tmp_path / "out"))
    assert [one.row.warnings for one in Batch(BatchRequest(plan, model=loader))] == [TOLD]
    assert json.loads((tmp_path / "out" / "manifest.jsonl").read_text())["warnings"] == [*TOLD]


def test_image_for_each_eye_is_told() -> None:
    data = saved("MPO", 2)
    assert read_image(None, data).warnings == ()  # Pillow states no kind
    entries = data.index(b"MPF\0") + 4 + 50
    stereo = data[:entries] + b"\x02\x00\x02\x00" + data[entries + 4 :]
    assert len(read_image(None, stereo).warnings) == 1
