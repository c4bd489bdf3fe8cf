"""``--upsample`` and ``--tile`` of every command that has them."""

import numpy as np
from helpers.command_line import Cli
from helpers.tiny import write_picture


def test_tiles_change_the_map_but_not_its_size(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    for name, options in (("a", ()), ("b", ("--tile", "auto")), ("c", ("--upsample", "bilinear"))):
        assert inside("predict", "room.png", "-o", f"{name}.npy", *options).returncode == 0
    maps = [np.load(inside.folder / f"{name}.npy") for name in "abc"]
    assert {m.shape for m in maps} == {(48, 64)}
    assert all(np.abs(maps[0] - other).max() > 1e-3 for other in maps[1:])
    wide = inside("predict", "room.png", "-o", "d.npy", "--tile", "9999")
    assert wide.returncode == 0
    assert b"--tile: " in wide.stderr
    assert np.array_equal(np.load(inside.folder / "d.npy"), maps[0])
