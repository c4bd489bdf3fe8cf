"""Files that are cut off, damaged or lying are refused before they cost anything."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers import made
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.errors import InputError
from depthcli.io.images.decode import picture_size
from depthcli.io.images.read import read_image

if TYPE_CHECKING:
    from pathlib import Path

WIDTH, HEIGHT = 40, 24
PICTURE = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def encoded(suffix: str, *options: int) -> bytes:
    ok, data = cv2.imencode(suffix, PICTURE, options)
    assert ok
    return data.tobytes()


FILES = {
    "jpeg": encoded(".jpg"),
    "progressive jpeg": encoded(".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "jpeg with restarts": encoded(".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 1),
    "png": encoded(".png"),
    "tiff": encoded(".tiff"),
    "webp": encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 80),
    "lossless webp": encoded(".webp"),
    "extended webp": made.webp_with_exif(encoded(".webp"), made.exif(), WIDTH, HEIGHT),
    "avif": encoded(".avif"),
    "bmp": encoded(".bmp"),
    "gif": encoded(".gif"),
    "pnm": encoded(".ppm"),
}


def reason(data: bytes, **options: int) -> str:
    with pytest.raises(InputError) as caught:
        read_image(None, data, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", FILES)
def test_the_size_is_known_before_decoding(name: str) -> None:
    assert picture_size(FILES[name]) == (WIDTH, HEIGHT)
    assert read_image(None, FILES[name]).pixels.shape == PICTURE.shape
    assert f"{WIDTH}×{HEIGHT}" in reason(FILES[name], max_pixels=WIDTH * HEIGHT - 1)
    assert read_image(None, FILES[name], max_pixels=WIDTH * HEIGHT).width == WIDTH


@pytest.mark.parametrize(
    "data",
    [
        b"MM\0*" + struct.pack(">IH", 8, 2)
        + struct.pack(">HHIHHHHII", 256, 3, 1, 70, 0, 257, 4, 1, 90),
        b"II+\0" + struct.pack("<HHQQ", 8, 0, 16, 2)
        + struct.pack("<HHQQHHQQ", 256, 16, 1, 70, 257, 4, 1, 90),
        b"BM" + bytes(12) + struct.pack("<IHH", 12, 70, 90),
        b"BM" + bytes(12) + struct.pack("<Iii", 40, 70, -90),
        b"P5 # a comment\n70 # another\n 90\n255\n",
    ],
    ids=["big-endian tiff", "bigtiff", "OS/2 bmp", "bmp from the top", "pgm with comments"],
)  # fmt: skip
def test_the_size_in_rarer_headers(data: bytes) -> None:
    assert picture_size(data) == (70, 90)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.8, 0.97])
def test_every_truncation_is_refused(name: str, share: float, capfd: pytest.CaptureFixture) -> None:
    reason(FILES[name][: int(len(FILES[name]) * share)])
    assert capfd.readouterr().err == ""


def test_the_end_of_a_thumbnail_is_not_the_end_of_a_jpeg() -> None:
    thumbnail = made.jpeg([[128]])
    whole = made.jpeg_with_exif(FILES["jpeg"], made.exif() + thumbnail)
    assert read_image(None, whole).width == WIDTH
    assert "truncated" in reason(whole[:-30])


def test_bytes_after_the_end_do_no_harm() -> None:
    for name in ("jpeg", "png"):
        assert read_image(None, FILES[name] + bytes(100_000)).width == WIDTH


def test_a_damaged_png_is_one_line(capfd: pytest.CaptureFixture) -> None:
    data = bytearray(FILES["png"])
    data[len(data) // 2] ^= 1
    assert "checksum" in reason(bytes(data))
    assert capfd.readouterr().err == ""


def test_a_damaged_comment_does_no_harm() -> None:
    data = bytearray(FILES["png"])
    text = bytearray(made.chunk(b"tEXt", b"Comment\0hello"))
    text[-1] ^= 1
    assert read_image(None, bytes(data[:33] + text + data[33:])).width == WIDTH


@pytest.mark.parametrize(
    ("name", "at", "form"),
    [("jpeg", None, ">HH"), ("png", 16, ">II"), ("bmp", 18, "<II"), ("gif", 6, "<HH")],
)
def test_bombs_and_nothing(name: str, at: int | None, form: str) -> None:
    data = bytearray(FILES[name])
    at = data.index(b"\xff\xc0") + 5 if at is None else at
    struct.pack_into(form, data, at, 50_000, 50_000)
    assert "50000×50000" in reason(bytes(data))
    struct.pack_into(form, data, at, 0, 0)
    assert "0×0" in reason(bytes(data))


def test_other_things_are_no_pictures() -> None:
    for data in (b"%PDF-1.7 ...", b"PK\3\4....", b"<svg></svg>", b"\0" * 1000, b"P6", b"BM"):
        assert "is not a picture" in reason(data)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(FILES)), st.data())
def test_damage_is_an_error_or_a_picture(name: str, draw: st.DataObject) -> None:
    data = bytearray(FILES[name])
    for at in draw.draw(st.lists(st.integers(0, len(data) - 1), min_size=1, max_size=4)):
        data[at] = draw.draw(st.integers(0, 255))
    try:
        frame = read_image(None, bytes(data), max_pixels=100_000)
    except InputError:
        return
    assert frame.pixels.ndim in (2, 3)


def test_a_name_that_is_too_long_is_refused() -> None:
    with pytest.raises(InputError, match="cannot be read: File name too long"):
        read_image("a" * 300)


def test_a_hundred_megapixels_are_read(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    ok, data = cv2.imencode(".png", np.full((10_000, 10_000), 7, np.uint8))
    assert ok
    path.write_bytes(data.tobytes())
    frame = read_image(path)
    assert frame.pixels.shape == (10_000, 10_000)
    assert (frame.pixels[::999, ::999] == 7).all()
