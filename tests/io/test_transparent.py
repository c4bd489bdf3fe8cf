"""Transparent pixels: no depth, and no effect of the colours that programs leave in them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO
import pytest
from helpers.heifs import heic
from helpers.tiny import load, write_model
from PIL import Image

import depthcli
from depthcli.errors import InputError
from depthcli.io.images.read import frame_of, read_image


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
    assert frame.transparent is not None
    np.testing.assert_array_equal(frame.transparent, np.broadcast_to(np.arange(32) >= 16, (24, 32)))
    assert frame.pixels.tolist() == np.full((24, 32, 3), 128).tolist()
    assert ["50%" in text for text in frame.warnings] == [True]
    plain = read_image(path, ignore_alpha=True)
    assert (plain.transparent, plain.warnings) == (None, ())
    assert plain.pixels[0, 31].tolist() == [under] * 3


@pytest.mark.parametrize("mode", ["RGBA", "LA", "array"])
def test_depth_of_transparent_pixels_is_missing(tmp_path: Path, mode: str) -> None:
    image: Any = np.asarray(_sprite(0)) if mode == "array" else _sprite(0, mode)
    depth = load(write_model(tmp_path / "m")).predict(frame_of(image)).depth
    np.testing.assert_array_equal(
        np.isnan(depth.values), np.broadcast_to(np.arange(32) >= 16, (24, 32))
    )
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


@pytest.mark.parametrize("name", ["a.avif", "a.jxl", "a.heic"])
def test_transparency_of_rarer_formats(tmp_path: Path, name: str) -> None:
    rgba = np.asarray(_sprite(0))
    if name == "a.avif":
        ten_bits = rgba[..., [2, 1, 0, 3]].astype(np.uint16) * 4
        options = (cv2.IMWRITE_AVIF_DEPTH, 10, cv2.IMWRITE_AVIF_QUALITY, 95)
        data = cv2.imencode(".avif", ten_bits, options)[1].tobytes()
    elif name == "a.jxl":
        OpenImageIO.ImageBuf(rgba).write(str(tmp_path / name))
        data = (tmp_path / name).read_bytes()
    else:
        data = heic(rgba)
    frame = read_image(None, data)
    assert frame.transparent is not None
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
    image = _sprite(0)
    exif = Image.Exif()
    exif[0x0112] = 6
    image.save(tmp_path / "a.png", exif=exif)
    frame = depthcli.read_image(tmp_path / "a.png")
    assert frame.transparent is not None
    assert frame.transparent.shape == (32, 24)
    assert frame.transparent[16:].all()
    assert not frame.transparent[:16].any()
