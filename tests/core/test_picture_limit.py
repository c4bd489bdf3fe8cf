"""Pictures that are too large are known by their size."""

from __future__ import annotations

import re

import pytest

from depthcli.core.choices import AUTO_TILE, Detail, Upsampling
from depthcli.core.picture_limit import PictureLimit, bytes_needed, megabytes, size_text
from depthcli.errors import InputError, UsageError

MANY = 10**12
SIZE = 3000, 2000


def test_as_many_pixels_as_allowed_pass() -> None:
    PictureLimit(100).check("a.png", 10, 10)
    with pytest.raises(InputError, match=r"a\.png claims 101×1 pixels, more than 100"):
        PictureLimit(100).check("a.png", 101, 1)


def test_as_many_bytes_as_allowed_pass() -> None:
    count = SIZE[0] * SIZE[1]
    needed = bytes_needed(*SIZE, Detail(), count)
    assert needed > count
    PictureLimit(MANY, Detail(max_memory_bytes=needed)).check("a.png", *SIZE)
    with pytest.raises(InputError, match=r"a\.png: 3000×2000 pixels need") as refused:
        PictureLimit(MANY, Detail(max_memory_bytes=needed - 1)).check("a.png", *SIZE)
    said = re.search(r"raise it to (\d+)M", str(refused.value))
    assert said is not None
    in_colour = bytes_needed(*SIZE, Detail(), 3 * count)
    assert 0 <= int(said[1]) * 1_000_000 - in_colour < 1_000_000


def test_what_uses_the_map_needs_memory_for_each_pixel() -> None:
    plain, used = (bytes_needed(*SIZE, Detail(use_bytes=n), 0) for n in (0, 5))
    assert used - plain == 5 * SIZE[0] * SIZE[1]
    assert bytes_needed(*SIZE, Detail(), 7) - plain == 7


@pytest.mark.parametrize(
    ("count", "text"),
    [(10, "10"), (999, "999"), (1000, "1K"), (200_000, "200K"), (15e6, "15M"), (1.5e9, "1.5G")],
)
def test_a_limit_is_said_as_it_was_given(count: float, text: str) -> None:
    assert size_text(count) == text


def test_megabytes_are_rounded_up() -> None:
    assert [megabytes(n) for n in (1, 1_000_000, 1_000_001)] == ["1M", "1M", "2M"]


def test_choices_are_taken_as_plain_words_too() -> None:
    assert Detail(upsampling="bilinear").upsampling is Upsampling.BILINEAR  # type: ignore[arg-type]


def test_tiles_of_a_negative_width_are_refused() -> None:
    assert Detail(tile_px=AUTO_TILE).tile_px == AUTO_TILE == 0
    with pytest.raises(UsageError, match="0 or more, not -1"):
        Detail(tile_px=-1)
