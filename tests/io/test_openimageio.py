"""Formats of the extra with OpenImageIO: film, print, and rarer layouts of TIFF."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import made
from helpers.made import written_by_oiio as written

from depthcli.errors import InputError
from depthcli.io.images import openimageio
from depthcli.io.images.read import check, read_image

pytest.importorskip("OpenImageIO")

_ROWS, _COLUMNS = np.mgrid[:24, :40]
BYTES = np.dstack([_COLUMNS * 6, _ROWS * 10, 255 - _COLUMNS * 6]).astype(np.uint8)
WORDS = BYTES.astype(np.uint16) * 257
LIGHT = (BYTES / 255).astype(np.float32)


@pytest.mark.parametrize(
    ("name", "pixels", "facts"),
    [
        ("a.dpx", WORDS, {}),
        ("a.dpx", WORDS, {"oiio__BitsPerSample": 10, "PixelAspectRatio": 2.0}),  # OpenImageIO #561
        ("a.tga", BYTES, {}),
        ("v1.tga", BYTES, {}),  # without its optional footer (mitsuba#2, imager#184)
        ("a.jxl", BYTES, {"compression": "jpegxl:100"}),
        ("a.tif", WORDS, {"planarconfig": "separate"}),
        ("a.tif", LIGHT, {"planarconfig": "separate"}),
        ("a.tif", LIGHT.astype(np.float16), {}),
        ("a.tif", np.dstack([BYTES, BYTES[..., :2]]), {}),
    ],
)
def test_image_is_read(
    name: str, pixels: npt.NDArray[Any], facts: dict[str, Any], tmp_path: Path
) -> None:
    data = written(tmp_path / name, pixels, **facts)
    data = data[:-26] if name == "v1.tga" else data
    frame = read_image(None, data)
    top = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1
    found_top = np.iinfo(frame.pixels.dtype).max if frame.pixels.dtype.kind == "u" else 1
    assert frame.pixels.shape == BYTES.shape
    assert frame.pixel_aspect == facts.get("PixelAspectRatio", 1)
    np.testing.assert_allclose(frame.pixels / found_top, pixels[..., :3] / top, atol=0.02)
    with pytest.raises(InputError):
        check(data, name, max_pixels=24 * 40 - 1)


def test_linear_light_is_encoded_as_srgb(tmp_path: Path) -> None:
    data = written(tmp_path / "a.hdr", LIGHT)
    curve = np.where(LIGHT <= 0.0031308, 12.92 * LIGHT, 1.055 * LIGHT ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(read_image(None, data).pixels, curve, atol=0.01)
    darker = read_image(None, data, exposure=-1).pixels
    assert darker.mean() < curve.mean()
    (warning,) = read_image(None, data, exposure=6).warnings
    assert "are above 1" in warning


@pytest.mark.parametrize("kind", [0, 1])
def test_gray_tiff_with_alpha_or_inverted_has_its_brightness(kind: int) -> None:
    gray = WORDS[..., :2]
    image = read_image(None, made.tiff(gray, photometric=1, extra=(2,))).pixels
    np.testing.assert_array_equal(image, gray[..., 0])
    inverted = read_image(None, made.tiff(gray[..., kind], photometric=0)).pixels
    np.testing.assert_array_equal(inverted, 65535 - gray[..., kind])


def test_damaged_file_is_refused(tmp_path: Path) -> None:
    data = written(tmp_path / "a.dpx", WORDS)
    for damaged in (data[:100], data[: len(data) // 2]):
        with pytest.raises(InputError):
            read_image(None, damaged)


@pytest.mark.parametrize(
    "start", [b"SDPX", b"8BPS", b"#?RADIANCE", b"\xff\x0a", b"\x80\x2a\x5f\xd7"]
)
def test_without_the_extra_it_says_what_to_add(
    start: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(openimageio, "is_installed", lambda _: False)
    for data in (start + bytes(2000), made.tiff(np.zeros((2, 2, 5), np.uint8))):
        with pytest.raises(InputError):
            read_image(None, data)


def test_compression_that_no_reader_has_is_named() -> None:
    """ZSTD "is damaged", it said."""
    plain, zstd = (struct.pack("<HHIHH", 259, 3, 1, code, 0) for code in (1, 50_000))
    data = made.tiff(np.zeros((8, 8), np.uint8)).replace(plain, zstd)
    with pytest.raises(InputError, match="ZSTD compression support is not configured"):
        read_image(None, data)


@pytest.mark.parametrize("tile", [(16, 16), (48, 32)])
@pytest.mark.parametrize("channels", [1, 3])
def test_uncompressed_tiles_of_any_size_are_read(
    tmp_path: Path, channels: int, tile: tuple[int, int]
) -> None:
    """tifffile's ``tile=(16, 16)`` and ``tiffcp -t -w 16 -l 16`` write such files."""
    pixels = np.random.default_rng(0).integers(0, 255, (40, 56, channels), np.uint8)
    data = written(tmp_path / "a.tif", pixels, tile, compression="none")
    image = read_image(None, data).pixels
    np.testing.assert_array_equal(image, pixels if channels == 3 else pixels[..., 0])
