"""Images that are too large are known by their size."""

import pytest

from depthcli.core.options import AUTO_TILE, Upsampling, UpsamplingOptions, check_pixel_count
from depthcli.errors import InputError, UsageError


def test_as_many_pixels_as_allowed_pass() -> None:
    check_pixel_count("a.png", 10, 10, 100)
    with pytest.raises(InputError) as refused:
        check_pixel_count("a.png", 101, 1, 100)
    assert "101×1" in refused.value.message.problem
    assert "{max_pixels}" in refused.value.message.advice


def test_choices_are_taken_as_plain_words_too() -> None:
    assert UpsamplingOptions(upsampling="bilinear").upsampling is Upsampling.BILINEAR  # type: ignore[arg-type]


def test_tiles_of_a_negative_width_are_refused() -> None:
    assert UpsamplingOptions(tile_px=AUTO_TILE).tile_px == AUTO_TILE == 0
    with pytest.raises(UsageError):
        UpsamplingOptions(tile_px=-1)
