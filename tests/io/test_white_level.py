"""16-bit pictures whose white is below 65535, as of cameras with 10 or 12 bits."""

import struct
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest

from depthcli.errors import UsageError
from depthcli.io.images.read import read_image

RNG = np.random.default_rng(0)
COLOURS = RNG.integers(0, 4096, (24, 32, 3), dtype=np.uint16)


def encoded(suffix: str, pixels: np.ndarray[Any, Any]) -> bytes:
    ok, data = cv2.imencode(suffix, pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    assert ok
    return data.tobytes()


def packed_tiff(values: Sequence[int], bits: int) -> bytes:
    """A gray TIFF of one row, whose pixels take so many bits."""
    text = "".join(f"{value:0{bits}b}" for value in values)
    row = bytes(int(text[i : i + 8].ljust(8, "0"), 2) for i in range(0, len(text), 8))
    facts = [(256, len(values)), (257, 1), (258, bits), (259, 1), (262, 1), (273, 8 + 2 + 112)]
    facts += [(277, 1), (278, 1), (279, len(row))]
    head = b"II*\0" + struct.pack("<IH", 8, len(facts))
    tags = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in facts)
    return head + tags + struct.pack("<I", 0) + row


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


def test_pictures_of_other_types_stay_as_they_are() -> None:
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
