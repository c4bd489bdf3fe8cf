"""Resizing of other libraries, against them or a plain loop."""

import numpy as np
import pytest
from PIL import Image

from depthcli.core.imageops import resize_antialiased, resize_corners

SIZES = [(13, 7), (50, 40), (60, 150), (200, 150)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("cubic", [False, True])
def test_antialiased_is_that_of_pillow(size: tuple[int, int], cubic: bool) -> None:
    values = np.random.default_rng(0).random((97, 133), dtype=np.float32)
    method = Image.Resampling.BICUBIC if cubic else Image.Resampling.BILINEAR
    theirs = np.asarray(Image.fromarray(values).resize(size, method))
    np.testing.assert_allclose(resize_antialiased(values, *size, cubic=cubic), theirs, atol=1e-6)


def test_antialiased_rounds_as_pillow_does_with_eight_bits() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (60, 90, 3), np.uint8)
    theirs = np.asarray(Image.fromarray(pixels).resize((31, 44), Image.Resampling.BICUBIC))
    values = pixels.astype(np.float32) / 255
    ours = resize_antialiased(values, 31, 44, cubic=True, eight_bit=True) * 255
    assert np.mean(np.rint(ours) != theirs) < 0.01  # ties


def test_corners_keep_their_place() -> None:
    values = np.random.default_rng(2).random((5, 7), dtype=np.float32)
    ours = resize_corners(values, 19, 4)
    for row in range(4):
        for column in range(19):
            y, x = row * 4 / 3, column * 6 / 18
            top, left = min(int(y), 3), min(int(x), 5)
            (a, b), (c, d) = values[top : top + 2, left : left + 2]
            down, across = y - top, x - left
            upper, lower = a + across * (b - a), c + across * (d - c)
            assert ours[row, column] == pytest.approx(upper + down * (lower - upper), abs=1e-5)


def test_corners_of_a_single_row() -> None:
    np.testing.assert_array_equal(resize_corners(np.float32([[1, 3]]), 3, 2), [[1, 2, 3]] * 2)
