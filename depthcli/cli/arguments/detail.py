"""Upsampling, tiles and memory limit from the command line."""

import re
from collections.abc import Iterable

from depthcli.core.choices import AUTO_TILE, Detail, Upsampling
from depthcli.core.text import short_repr
from depthcli.errors import UsageError

# Bytes per pixel besides picture and depth, measured with a margin; the first is the minimum.
_MIN_USE_BYTES = 10
_SIDE_BY_SIDE_BYTES = 18
_UNITS = {"": 1, "K": 1_000, "M": 1_000_000, "G": 1_000_000_000}
_SIZE = r"(?ia)(\d{1,18}(?:\.\d{1,18})?) ?([KMG]?)B?"
_WIDTH = r"0*[1-9][0-9]{0,8}"


def choose_detail(
    upsampling: Upsampling,
    tile: str | None,
    max_memory: str | None,
    use_bytes: Iterable[int] = (),
    *,
    side_by_side: bool = False,
) -> Detail:
    """Parse the options.

    ``tile`` is ``auto`` or a width in pixels, ``max_memory`` a number of bytes, or one with K, M or
    G. ``use_bytes`` is the memory per pixel of each format.

    Raises:
        UsageError: an option is not of this form.
    """
    most = max(use_bytes, default=0) + (_SIDE_BY_SIDE_BYTES if side_by_side else 0)
    return Detail(upsampling, _tile_px(tile), _bytes(max_memory), max(_MIN_USE_BYTES, most))


def _tile_px(text: str | None) -> int | None:
    if text is None:
        return None
    if text == "auto":
        return AUTO_TILE
    if not re.fullmatch(_WIDTH, text):
        raise UsageError(f"--tile is auto or a width in pixels, not {short_repr(text)}")
    return int(text)


def _bytes(text: str | None) -> int | None:
    if text is None:
        return None
    match = re.fullmatch(_SIZE, text.strip())
    if match is None:
        raise UsageError(
            f"--max-memory is a number of bytes such as 800M or 2G, not {short_repr(text)}"
        )
    return int(float(match[1]) * _UNITS[match[2].upper()])
