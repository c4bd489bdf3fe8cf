"""Upsampling and tiles from the command line."""

import re

from depthcli.core.choices import AUTO_TILE, Detail, Upsampling
from depthcli.core.text import short_repr
from depthcli.errors import UsageError

_WIDTH = r"0*[1-9][0-9]{0,8}"


def choose_detail(upsampling: Upsampling, tile: str | None) -> Detail:
    """Parse the options; ``tile`` is ``auto`` or a width in pixels.

    Raises:
        UsageError: an option is not of this form.
    """
    return Detail(upsampling, _tile_px(tile))


def _tile_px(text: str | None) -> int | None:
    if text is None:
        return None
    if text == "auto":
        return AUTO_TILE
    if not re.fullmatch(_WIDTH, text):
        raise UsageError(f"--tile is auto or a width in pixels, not {short_repr(text)}")
    return int(text)
