"""Of a file with several pictures the first is used, and the user is told of the others."""

from __future__ import annotations

import json
import struct
from io import BytesIO
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from helpers.tiny import write_model
from PIL import Image

from depthcli.inference.loading import SessionLoader
from depthcli.io.images.decode import count_warnings
from depthcli.io.images.read import read_image
from depthcli.jobs.batch.options import BatchRequest
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.run import Batch
from depthcli.jobs.predict.request import PredictRequest
from depthcli.jobs.predict.run import predict

if TYPE_CHECKING:
    from pathlib import Path

TOLD = ("has 3 pictures; only the first is used",)
PICTURES = list(np.random.default_rng(0).integers(0, 255, (3, 40, 60, 3), np.uint8))


def saved(kind: str, count: int, **options: Any) -> bytes:
    first, *others = map(Image.fromarray, PICTURES[:count])
    file = BytesIO()
    first.save(file, kind, save_all=True, append_images=others, **options)
    return file.getvalue()


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("TIFF", {}),
        ("TIFF", {"compression": "tiff_lzw"}),
        ("TIFF", {"big_tiff": True}),
        ("GIF", {}),
        ("GIF", {"comment": b"x" * 700, "loop": 0}),
        ("PNG", {}),
        ("PNG", {"default_image": True}),
        ("WEBP", {}),
        ("WEBP", {"lossless": True, "exif": b"Exif\0\0II*\0"}),
    ],
)
def test_others_than_the_first_are_told(kind: str, options: dict[str, Any]) -> None:
    count = 2 if "default_image" in options else 3
    data = saved(kind, 3, **options)
    told = (f"has {count} pictures; only the first is used",)
    assert read_image(None, data).warnings == told
    assert read_image(None, saved(kind, 1)).warnings == ()
    for end in range(0, len(data), 97):  # whatever it says of a part, it ends
        count_warnings(data[:end])


def test_both_orders_of_bytes() -> None:
    ok, data = cv2.imencodemulti(".tiff", PICTURES)
    assert ok
    assert count_warnings(data.tobytes()) == TOLD
    assert count_warnings(tiff(">", [0, 0, 0])) == TOLD


@pytest.mark.parametrize(("kinds", "count"), [([0, 1, 4, 5], 1), ([1, 0], 2), ([0, 2, 2], 3)])
def test_thumbnails_and_masks_are_no_pictures(kinds: list[int], count: int) -> None:
    told = (f"has {count} pictures; only the first is used",) if count > 1 else ()
    assert count_warnings(tiff("<", kinds)) == told


def tiff(order: str, kinds: list[int]) -> bytes:
    """A TIFF of directories that have nothing but a kind; the last one leads to the first."""
    data = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(order + "I", 8)
    for number, kind in enumerate(kinds, 1):
        following = 8 + 18 * (number % len(kinds))
        data += struct.pack(order + "HHHIII", 1, 254, 4, 1, kind, following)
    return data


def test_it_is_a_warning_of_the_picture(tmp_path: Path) -> None:
    source = tmp_path / "in" / "a.gif"
    source.parent.mkdir()
    source.write_bytes(saved("GIF", 3))
    loader = SessionLoader(write_model(tmp_path / "model"), "cpu")
    (result,) = predict(PredictRequest((str(source),), f"{tmp_path / 'one'}/", model=loader))
    assert result.warnings == TOLD
    plan = plan_folder(str(source.parent), str(tmp_path / "out"))
    assert [one.row.warnings for one in Batch(BatchRequest(plan, model=loader))] == [TOLD]
    assert json.loads((tmp_path / "out" / "manifest.jsonl").read_text())["warnings"] == [*TOLD]
