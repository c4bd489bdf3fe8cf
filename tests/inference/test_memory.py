"""``--max-memory``: what is counted before a picture is seen is what it takes."""

from __future__ import annotations

import re
import tracemalloc

import numpy as np
import pytest

from depthcli.core.choices import Detail
from depthcli.core.types import Frame
from depthcli.errors import InputError
from depthcli.inference.memory import tile_width_px
from depthcli.inference.preprocess import prepare
from depthcli.models.card_specs import Colour, Fit, InputSpec, Resize


def spec(resize: Resize, colour: Colour = Colour.VALUE) -> InputSpec:
    mean, std = (0.5,) * colour.channels, (0.5,) * colour.channels
    return InputSpec(colour, 160, 120, True, 1, Fit.STRETCH, mean, std, resize)


def test_the_tiles_that_a_refusal_names_fit() -> None:
    frame = Frame(np.zeros((480, 640), np.uint8))

    def width(tile_px: int, limit: str = "12M") -> int | None:
        detail = Detail(tile_px=tile_px, max_memory_bytes=int(limit[:-1]) * 1_000_000)
        return tile_width_px(spec(Resize.AREA), frame, detail)

    with pytest.raises(InputError) as refused:
        width(96)
    found = re.fullmatch(
        r"tiles of 96 pixels need (\d+M), more than --max-memory 12M; raise it to (\d+M) or give "
        r"--tile (\d+)",
        str(refused.value),
    )
    assert found is not None
    assert found[1] == found[2]
    assert width(96, found[1]) == 96
    assert width(int(found[3])) == int(found[3])
    with pytest.raises(InputError, match="tiles of"):
        width(int(found[3]) - 1)
    with pytest.raises(InputError, match=rf"less detail .* give --tile {found[3]} or more"):
        width(40)
    with pytest.raises(InputError, match=r"give --tile \d\d or more"):
        width(40, "9000M")


@pytest.mark.parametrize("colour", [Colour.VALUE, Colour.RGB])
def test_what_a_cubic_card_sees_at_full_size_counts(colour: Colour) -> None:
    """What is counted bounds what is taken, and is not taken out of the air."""
    frame = Frame(np.zeros((1200, 1600, 3), np.uint8))
    detail = Detail(max_memory_bytes=10)
    with pytest.raises(InputError, match=r"need (\d+)M") as refused:
        tile_width_px(spec(Resize.CUBIC, colour), frame, detail)
    counted = int(re.findall(r"need (\d+)M", str(refused.value))[0]) * 1_000_000
    prepare(spec(Resize.CUBIC, colour), frame)  # what is made once is made
    tracemalloc.start()
    prepare(spec(Resize.CUBIC, colour), frame)
    taken = frame.pixels.nbytes + tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert taken < counted < 3 * taken
