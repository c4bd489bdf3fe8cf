"""How much memory a picture takes on its way to depth, known before any of it is taken."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from depthcli.core.bands import BAND_PIXELS
from depthcli.core.choices import AUTO_TILE, DEPTH_BYTES
from depthcli.errors import InputError
from depthcli.inference.card_specs import Colour, Resize

if TYPE_CHECKING:
    from depthcli.core.choices import Detail
    from depthcli.core.types import Frame
    from depthcli.inference.card_specs import InputSpec

# Counted in the code, with some to spare: planes of one band, and maps of the size of a tiled map.
_BYTES_A_BAND_PIXEL = 64
_BYTES_A_CELL = 64
_FLOAT_PLANES = 2  # the plane and its scaled copy
_MEGABYTE = 1_000_000


def tile_width_px(spec: InputSpec, frame: Frame, detail: Detail) -> int | None:
    """Width of the tiles of one picture, within the limit of memory.

    Args:
        spec: the card's input.
        frame: the picture.
        detail: what was asked for.

    Returns:
        Pixels of the picture; None if it goes through the network in one piece.

    Raises:
        InputError: the limit is too low for this picture or these tiles.
    """
    limit = math.inf if detail.max_memory_bytes is None else detail.max_memory_bytes
    fixed = _fixed_bytes(spec, frame, detail.use_bytes)
    if fixed > limit:
        raise InputError(
            f"{frame.width}×{frame.height} pixels need {_megabytes(fixed)}, more than "
            f"--max-memory {_megabytes(limit)}; raise it or make the picture smaller"
        )
    most_cells = (limit - fixed) / _BYTES_A_CELL
    least_px = math.ceil(frame.width * math.sqrt(spec.width * spec.height / max(1.0, most_cells)))
    if detail.tile_px is None:
        return None
    if detail.tile_px == AUTO_TILE:
        chosen = max(-(-3 * frame.width // 4), spec.width, least_px)
        return chosen if chosen < frame.width else None
    if detail.tile_px < least_px:
        raise InputError(
            f"tiles of {detail.tile_px} pixels need more than --max-memory {_megabytes(limit)}; "
            f"raise it or give --tile {min(least_px, frame.width)}"
        )
    return detail.tile_px if detail.tile_px < frame.width else None


def _fixed_bytes(spec: InputSpec, frame: Frame, use_bytes: int) -> int:
    """What is needed without tiles: the pixels, a band, and the most of what comes in turn."""
    count = frame.width * frame.height
    band = min(count, max(BAND_PIXELS, frame.width)) * _BYTES_A_BAND_PIXEL
    depth = DEPTH_BYTES * count
    then = max(_seen_bytes(spec, count), depth + use_bytes * count)
    # What bands took is not given back at once.
    return frame.pixels.nbytes + then + band


def _seen_bytes(spec: InputSpec, count: int) -> int:
    """What the network sees at full size; only an area mean is taken band by band."""
    if spec.resize is Resize.AREA:
        return 0
    planes = 3 if spec.colour is Colour.RGB else 1
    return _FLOAT_PLANES * planes * 4 * count


def _megabytes(count: float) -> str:
    return f"{math.ceil(count / _MEGABYTE)}M"
