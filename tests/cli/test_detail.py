"""``--upsample`` and ``--tile`` of every command that has them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from helpers.tiny import write_picture

from depthcli.cli import shell

if TYPE_CHECKING:
    from helpers.command_line import Cli

DOCS = Path(__file__).resolve().parents[2] / "docs"
HEIGHT, WIDTH = 2400, 3200
# Prints a process's greatest memory in kilobytes; a process of its own, because a child's figure
# begins with its parent's.
PEAK = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], capture_output=True)
sys.stderr.buffer.write(done.stderr)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(done.returncode)
"""


@pytest.mark.parametrize("name", ["predict", "batch", "video"])
def test_commands_have_the_options_that_their_page_names(name: str) -> None:
    page = (DOCS / "sharpness.md").read_text()
    own = {word for parameter in shell.load_command(name).params for word in parameter.opts}
    for option in ("--upsample", "--tile"):
        assert option in own
        assert f"`{option}`" in page


@pytest.mark.parametrize("option", [("--tile", "x"), ("--upsample", "cubic"), ("--tile", "0")])
def test_wrong_words(inside: Cli, option: tuple[str, str]) -> None:
    write_picture(inside.folder / "room.png")
    done = inside("predict", "room.png", *option)
    assert done.returncode == 2
    assert not list(inside.folder.glob("*.depth.png"))


def test_tiles_change_the_map_but_not_its_size(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    for name, options in (("a", ()), ("b", ("--tile", "auto")), ("c", ("--upsample", "bilinear"))):
        assert inside("predict", "room.png", "-o", f"{name}.npy", *options).returncode == 0
    maps = [np.load(inside.folder / f"{name}.npy") for name in "abc"]
    assert {m.shape for m in maps} == {(48, 64)}
    assert all(np.abs(maps[0] - other).max() > 1e-3 for other in maps[1:])
