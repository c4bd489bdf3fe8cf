"""White, black and transparent pixels of images."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import OpenImageIO
import pytest
from helpers.heifs import heic
from helpers.made import encoded, exif
from helpers.tiny import load, write_model
from PIL import Image

import depthcli
from depthcli.errors import InputError, UsageError
from depthcli.io.images.read import frame_of, read_image
from depthcli.video.source import open_frames

RNG = np.random.default_rng(0)
HIDDEN = np.broadcast_to(np.arange(32) >= 16, (24, 32))  #: of a sprite
COLOURS = RNG.integers(0, 4096, (24, 32, 3), dtype=np.uint16)


def packed_tiff(values: Sequence[int], bits: int) -> bytes:
    """A gray TIFF of one row, whose pixels take so many bits."""
    text = "".join(f"{value:0{bits}b}" for value in values)
    row = bytes(int(text[i : i + 8].ljust(8, "0"), 2) for i in range(0, len(text), 8))
    facts = [(256, len(values)), (257, 1), (258, bits), (259, 1), (262, 1), (273, 8 + 2 + 112)]
    facts += [(277, 1), (278, 1), (279, len(row))]
    head = b"II*\0" + struct.pack("<IH", 8, len(facts))
    tags = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in facts)
    return head + tags + struct.pack("<I", 0) + row


@pytest.mark.parametrize("name", ["a.avif", "a.heic", "a.mkv", "deep.mkv"])
def test_gray_of_limited_range_is_expanded(name: str, tmp_path: Path) -> None:
    """strukturag/libheif#580; FFmpeg leaves gray video as it is."""
    path, gray = tmp_path / name, np.linspace(0, 255, 128 * 96).reshape(96, 128)
    luma = np.rint(16 + gray * 219 / 255).astype(np.uint8)
    if name == "a.avif":
        image = Image.fromarray(np.rint(gray).astype(np.uint8))
        image.save(path, range="limited", subsampling="4:0:0", quality=100)
    elif name == "a.heic":
        path.write_bytes(heic(luma, quality=100, full_range_flag=False))
    else:
        pixel_format = "gray10le" if name == "deep.mkv" else "gray"
        with av.open(str(path), "w") as file:
            stream = file.add_stream("ffv1", rate=1)
            stream.height, stream.width = gray.shape
            stream.pix_fmt, stream.codec_context.color_range = pixel_format, 1
            frame = av.VideoFrame.from_ndarray(luma.astype(np.uint16) << 8, "gray16le")
            frame = frame.reformat(format=pixel_format)
            frame.color_range = 1
            file.mux([*stream.encode(frame), *stream.encode(None)])
    image = next(open_frames(path).frames()) if path.suffix == ".mkv" else read_image(path)
    pixels = image.pixels[..., 0] if image.pixels.ndim == 3 else image.pixels
    np.testing.assert_allclose(pixels / np.iinfo(pixels.dtype).max, gray / 255, atol=0.01)


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".pgm"])
@pytest.mark.parametrize("white", [1023, 4095, 65535])
def test_white_becomes_the_maximum(suffix: str, white: int) -> None:
    pixels = RNG.integers(0, white + 1, (24, 32), dtype=np.uint16)
    frame = read_image(None, encoded(suffix, pixels), white_level=white)
    assert (frame.pixels.dtype, frame.warnings) == (np.uint16, ())
    np.testing.assert_array_equal(frame.pixels, np.rint(pixels * (65535 / white)))


def test_colours_keep_their_ratio_and_what_is_above_white_is_told() -> None:
    frame = read_image(None, encoded(".png", COLOURS), white_level=4095)
    np.testing.assert_allclose(frame.pixels / 65535, COLOURS / 4095, atol=1e-5)
    frame = read_image(None, encoded(".png", COLOURS), white_level=1023)
    assert (frame.pixels[COLOURS > 1023] == 65535).all()
    brightest = COLOURS.max()
    (warning,) = frame.warnings
    assert str(brightest) in warning


def test_images_of_other_types_stay_as_they_are() -> None:
    shades, light = (COLOURS % 256).astype(np.uint8), (COLOURS / 4095).astype(np.float32)
    for data in (encoded(".png", shades), encoded(".tiff", light)):
        frame = read_image(None, data, white_level=100)
        np.testing.assert_array_equal(frame.pixels, read_image(None, data).pixels)
        assert frame.warnings == read_image(None, data).warnings


@pytest.mark.parametrize("white_level", [None, 4095, 60])
def test_white_level_of_the_file_is_used(white_level: int | None) -> None:
    frame = read_image(None, b"P5 3 1 1000\n" + struct.pack(">3H", 0, 500, 1000))
    np.testing.assert_array_equal(frame.pixels, [[0, 32768, 65535]])
    for bits in (10, 12, 14):
        middle, white = 1 << (bits - 1), (1 << bits) - 1
        data = packed_tiff([0, middle, white], bits)
        frame = read_image(None, data, white_level=white_level)
        np.testing.assert_array_equal(frame.pixels, [[0, round(middle * 65535 / white), 65535]])
        assert frame.warnings == ()


@pytest.mark.parametrize("white_level", [0, 65536, -1, 4095.5, "4095"])
def test_invalid_white_level_is_refused(white_level: Any) -> None:
    with pytest.raises(UsageError):
        read_image(None, encoded(".png", COLOURS), white_level=white_level)


def test_black_and_white_level_stretch_the_range_of_a_thermal_camera() -> None:
    pixels = np.linspace(6765, 7810, 24 * 32).reshape(24, 32).astype(np.uint16)
    data = encoded(".tiff", pixels)
    (warning,) = read_image(None, data).warnings
    assert {"black_level", "white_level"} <= {word.strip("{}") for word in warning.advice.split()}
    frame = read_image(None, data, white_level=7810, black_level=6765)
    np.testing.assert_array_equal(frame.pixels, np.rint((pixels - 6765.0) * (65535 / 1045)))
    assert frame.warnings == ()
    with pytest.raises(UsageError):
        read_image(None, data, white_level=100, black_level=100)


@pytest.mark.parametrize(
    ("white", "is_told"), [(1023, True), (4080, True), (4095, True), (60_000, False)]
)
def test_pixels_in_a_sliver_of_16_bits_are_told(white: int, is_told: bool) -> None:
    pixels = RNG.integers(0, white, (64, 64), dtype=np.uint16)
    pixels[1, 1] = white
    warnings = read_image(None, encoded(".png", pixels)).warnings
    assert [warning.advice.split()[-1] for warning in warnings] == [str(white)] * is_told


def _sprite(under: int, mode: str = "RGBA") -> Image.Image:
    """Gray 128 on the left; on the right, something under transparency."""
    pixels = np.full((24, 32, 4), 255, np.uint8)
    pixels[..., :3] = 128
    pixels[:, 16:, :3] = under
    pixels[:, 16:, 3] = 0
    return Image.fromarray(pixels).convert(mode)


@pytest.mark.parametrize("suffix", [".png", ".webp", ".tif"])
@pytest.mark.parametrize("under", [0, 255])
def test_colours_under_transparency_have_no_effect(tmp_path: Path, suffix: str, under: int) -> None:
    path = tmp_path / f"a{suffix}"
    options: dict[str, Any] = {"lossless": True, "exact": True} if suffix == ".webp" else {}
    _sprite(under).save(path, **options)
    frame = read_image(path)
    np.testing.assert_array_equal(frame.transparent, HIDDEN)
    assert frame.pixels.tolist() == np.full((24, 32, 3), 128).tolist()
    assert ["50%" in text for text in frame.warnings] == [True]
    plain = read_image(path, ignore_alpha=True)
    assert (plain.transparent, plain.warnings) == (None, ())
    assert plain.pixels[0, 31].tolist() == [under] * 3


@pytest.mark.parametrize("mode", ["RGBA", "LA", "array"])
def test_depth_of_transparent_pixels_is_missing(tmp_path: Path, mode: str) -> None:
    image: Any = np.asarray(_sprite(0)) if mode == "array" else _sprite(0, mode)
    depth = load(write_model(tmp_path / "m")).predict(frame_of(image)).depth
    np.testing.assert_array_equal(np.isnan(depth.values), HIDDEN)
    assert depth.values[0, 0] == pytest.approx(1 + 8 * 128 / 255, abs=1e-3)


def test_opaque_and_foreign_fourth_channels_are_no_transparency(tmp_path: Path) -> None:
    opaque = _sprite(0)
    opaque.putalpha(255)
    opaque.save(tmp_path / "a.png")
    assert read_image(tmp_path / "a.png").transparent is None
    _sprite(0).save(tmp_path / "a.tif")
    data = (tmp_path / "a.tif").read_bytes()
    # A fourth band of another kind, such as near infrared: ExtraSamples is 0.
    at = data.index((338).to_bytes(2, "little") + (3).to_bytes(2, "little"))
    (tmp_path / "a.tif").write_bytes(data[: at + 8] + b"\0\0" + data[at + 10 :])
    assert read_image(tmp_path / "a.tif").transparent is None


@pytest.mark.parametrize("name", ["a.avif", "a.jxl", "a.gif", "a.heic"])
def test_transparency_of_rarer_formats(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    rgba = np.asarray(_sprite(0))
    if name == "a.avif":
        ten_bits = rgba[..., [2, 1, 0, 3]].astype(np.uint16) * 4
        path.write_bytes(bytes(cv2.imencode(".avif", ten_bits, (cv2.IMWRITE_AVIF_DEPTH, 10))[1]))
    elif name == "a.jxl":
        OpenImageIO.ImageBuf(rgba).write(str(path))
    elif name == "a.gif":
        _sprite(0).save(path)
    else:
        path.write_bytes(heic(rgba))
    frame = read_image(path)
    assert frame.transparent[0].tolist() == [False] * 16 + [True] * 16
    assert abs(frame.pixels / np.iinfo(frame.pixels.dtype).max - 0.5).max() < 0.06


def test_image_that_is_transparent_everywhere_is_refused(tmp_path: Path) -> None:
    image = _sprite(0)
    image.putalpha(0)
    image.save(tmp_path / "a.png")
    with pytest.raises(InputError) as caught:
        read_image(tmp_path / "a.png")
    assert "a.png" in str(caught.value)
    assert "ignore_alpha" in str(caught.value)


def test_transparency_is_turned_with_its_image(tmp_path: Path) -> None:
    _sprite(0).save(tmp_path / "a.png", exif=exif(6))
    frame = depthcli.read_image(tmp_path / "a.png")
    assert frame.transparent.shape == (32, 24)
    assert frame.transparent[16:].all()
    assert not frame.transparent[:16].any()
