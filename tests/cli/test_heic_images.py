"""HEIC images on the command line: predict, batch, image sequences, object stores."""

import sys

import numpy as np
import pytest
from helpers import made
from helpers.command_line import Cli
from helpers.folders import contents, printed, rows, tree
from helpers.heifs import heic, pillow_heif
from helpers.tiny import synthetic_image
from PIL import Image

from depthcli.io.media import is_installed

IMAGE = synthetic_image(48, 64)
HEIC = heic(IMAGE)
MISSING = b"needs pillow-heif"


def test_the_depth_is_that_of_the_same_pixels(inside: Cli) -> None:
    (inside.folder / "a.heic").write_bytes(HEIC)
    Image.fromarray(np.asarray(pillow_heif.open_heif(HEIC))).save(inside.folder / "b.png")
    assert not inside("predict", "a.heic", "b.png", "-o", "out/", "--format", "npy", code=0).stderr
    outputs = contents(inside, "out")
    assert outputs["a.depth.npy"] == outputs["b.depth.npy"]
    piped = inside("predict", "-", "-o", "-", "--format", "npy", stdin=HEIC).stdout
    assert piped == outputs["a.depth.npy"]


def test_the_focal_length_in_exif_is_used_as_that_of_a_jpeg(inside: Cli) -> None:
    exif = b"Exif\0\0" + made.exif(6, focal_35mm=26)
    (inside.folder / "a.heic").write_bytes(heic(IMAGE, exif=exif))
    Image.fromarray(IMAGE).save(inside.folder / "b.jpg", exif=exif)
    done = inside("predict", "a.heic", "b.jpg", "--format", "png16", "--json")
    facts = [(row["width"], row["height"], row["camera"]) for row in printed(done)]
    assert facts[0] == facts[1]
    assert facts[0][:2] == (48, 64)
    assert facts[0][2].endswith("(from EXIF)")


def test_a_batch_reads_heic_by_pillow_heif(inside: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    tree(inside, "a.png")
    (inside.folder / "in" / "b.HEIC").write_bytes(HEIC)
    (inside.folder / "in" / "c.heic").write_bytes(HEIC[:-1])
    (inside.folder / "list").write_text("b.HEIC")
    with monkeypatch.context() as missing:
        missing.setitem(sys.modules, "pillow_heif", None)
        is_installed.cache_clear()
        assert b"2 files skipped (2 .heic)" in inside("batch", "in", "--out", "out").stdout
        listed = inside("batch", "in", "--files", "list", "--out", "other")
        assert (listed.returncode, MISSING in listed.stderr) == (1, True)
    is_installed.cache_clear()
    would = inside("batch", "in", "--out", "out", "--dry-run", "--json")
    assert [facts["would"] for facts in printed(would)] == ["keep", "do", "fail"]
    done = inside("batch", "in", "--out", "out", code=1)
    assert b"in/c.heic is truncated" in done.stderr
    by_name = rows(inside, "out")
    assert [row["status"] for row in by_name.values()] == ["ok", "ok", "failed"]
    assert contents(inside, "out").keys() == {"a.depth.png", "b.depth.png", "manifest.jsonl"}
    again = inside("batch", "in", "--out", "out", "--json")
    assert [facts.get("kept") for facts in printed(again)][:2] == [True, True]
    assert inside("batch", "in", "--files", "list", "--out", "other").returncode == 0


def test_a_folder_of_heic_is_an_image_sequence(inside: Cli) -> None:
    (inside.folder / "shots").mkdir()
    for number in (8, 9, 10):
        data = heic(np.roll(IMAGE, number, 1))
        (inside.folder / "shots" / f"IMG_{number}.HEIC").write_bytes(data)
    inside("video", "shots", "--fps", "5", "--out", "d.%d.npy", code=0)
    assert {"d.8.npy", "d.9.npy", "d.10.npy"} <= contents(inside, ".").keys()
    single = inside("video", "shots/IMG_8.HEIC")
    assert b"is a single image; use 'depthcli predict'" in single.stderr
