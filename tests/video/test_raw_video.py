"""Frames without a container, as ``ffmpeg -f rawvideo`` and OpenCV's users pipe them."""

import io
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from depthcli.errors import InputError
from depthcli.video.container import InputPipe, RawVideo
from depthcli.video.source import VideoSource

HEIGHT, WIDTH, FRAMES = 4, 6, 3
RGB = np.arange(FRAMES * HEIGHT * WIDTH * 3, dtype=np.uint8).reshape(FRAMES, HEIGHT, WIDTH, 3)
DEEP = np.linspace(0, 65535, FRAMES * HEIGHT * WIDTH).astype("<u2").reshape(RGB.shape[:3])


def read(data: bytes, pixel_format: str) -> tuple[VideoSource, list[Any]]:
    raw = RawVideo(WIDTH, HEIGHT, pixel_format, Fraction(30000, 1001))
    with VideoSource(InputPipe(io.BytesIO(data), raw)) as source:
        return source, list(source.frames())


@pytest.mark.parametrize(
    ("pixel_format", "sent", "pixels"),
    [
        ("bgr24", RGB[..., ::-1], RGB),
        ("rgb24", RGB, RGB),
        ("gray", RGB[..., 0], RGB[..., :1]),
        ("gray16le", DEEP, DEEP[..., None]),
    ],
)
def test_pixels_and_times_are_those_that_were_sent(
    pixel_format: str, sent: np.ndarray[Any, Any], pixels: np.ndarray[Any, Any]
) -> None:
    source, frames = read(sent.tobytes(), pixel_format)
    assert (source.rate, source.problem, len(frames)) == (Fraction(30000, 1001), None, FRAMES)
    for number, frame in enumerate(frames):
        expected = np.broadcast_to(pixels[number], (HEIGHT, WIDTH, 3))
        np.testing.assert_array_equal(frame.pixels, expected)
        assert frame.timestamp_s == pytest.approx(number * 1001 / 30000, abs=1e-9)


def test_an_incomplete_last_frame_is_told() -> None:
    source, frames = read(RGB.tobytes()[:-1], "rgb24")
    assert len(frames) == FRAMES - 1
    assert source.problem is not None


def test_less_than_a_frame_is_an_error() -> None:
    with pytest.raises(InputError, match="raw"):
        read(RGB.tobytes()[:30], "rgb24")
