"""Choosing tiles within the limit of memory, by an estimate before any is allocated."""

import math

from depthcli.core.choices import AUTO_TILE, Detail
from depthcli.core.picture_limit import (
    bytes_needed,
    megabytes,
    memory_limit,
    memory_limit_message,
    size_text,
)
from depthcli.core.types import Frame
from depthcli.errors import InputError
from depthcli.models.card_specs import Colour, InputSpec, Resize

# All arrays as large as a tiled map, as found by counting them in the code, and a margin.
_BYTES_A_CELL = 64
_MAX_CELLS_A_PIXEL = 4  # more show nothing of the picture
_FLOAT_PLANES = 2  # the plane and its scaled copy


def tile_width_px(spec: InputSpec, frame: Frame, detail: Detail) -> int | None:
    """Width of the tiles of a picture in its pixels, within the limit of memory.

    None if the picture is not tiled.

    Raises:
        InputError: the limit is too low for this picture or these tiles.
    """
    width, limit = frame.width, memory_limit(detail)
    fixed = bytes_needed(
        width, frame.height, detail, frame.pixels.nbytes, _input_bytes(spec, frame)
    )
    if fixed > limit:
        raise InputError(memory_limit_message(width, frame.height, fixed, detail))
    cells = spec.width * spec.height * width**2  # of the tiled map, times the tiles' width squared
    least_px = math.ceil(math.sqrt(cells / max(1.0, (limit - fixed) / _BYTES_A_CELL)))
    if detail.tile_px is None:
        return None
    finest_px = math.ceil(math.sqrt(cells / (_MAX_CELLS_A_PIXEL * width * frame.height)))
    if AUTO_TILE != detail.tile_px < min(finest_px, width):
        wide_px = max(finest_px, least_px)
        other = f"give --tile {wide_px} or more" if wide_px < width else "leave --tile out"
        raise InputError(
            f"tiles of {detail.tile_px} pixels have less detail than the network's input; {other}"
        )
    if detail.tile_px == AUTO_TILE:
        chosen = max(-(-3 * width // 4), spec.width, least_px)
        return chosen if chosen < width else None
    if detail.tile_px < least_px:
        needed = megabytes(fixed + _BYTES_A_CELL * cells / detail.tile_px**2)
        other = f"give --tile {least_px}" if least_px < width else "leave --tile out"
        raise InputError(
            f"tiles of {detail.tile_px} pixels need {needed}, more than --max-memory "
            f"{size_text(limit)}; raise it to {needed} or {other}"
        )
    return detail.tile_px if detail.tile_px < width else None


def _input_bytes(spec: InputSpec, frame: Frame) -> int:
    """Size of the network's input before it is resized; 0 for an area mean, done in bands."""
    if spec.resize is Resize.AREA:
        return 0
    planes = 3 if spec.colour is Colour.RGB else 1
    return _FLOAT_PLANES * planes * 4 * frame.width * frame.height
