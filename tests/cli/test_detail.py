"""``--upsample``, ``--tile`` and ``--max-memory`` of every command that has them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny import write_picture
from videos import flat_frames, write_mp4

from depthcli.cli import shell
from depthcli.cli.arguments.detail import choose_detail
from depthcli.core.bands import BAND_PIXELS
from depthcli.core.choices import Detail, Upsampling
from depthcli.core.picture_limit import PictureLimit, bytes_needed, size_text
from depthcli.errors import InputError, UsageError
from depthcli.io.writers.formats import Format

if TYPE_CHECKING:
    from command_line import Cli

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


@pytest.mark.parametrize(
    ("text", "count"), [("5", 5), ("800M", 800_000_000), ("1.5g", 1_500_000_000), ("2 KB", 2000)]
)
def test_sizes(text: str, count: int) -> None:
    assert choose_detail(Upsampling.GUIDED, None, text).max_memory_bytes == count


@pytest.mark.parametrize("text", ["", "x", "-1", "5T", "٥M"])
def test_sizes_that_are_none(text: str) -> None:
    with pytest.raises(UsageError, match="--max-memory is a number of bytes"):
        choose_detail(Upsampling.GUIDED, None, text)


@pytest.mark.parametrize("text", ["0", "-5", "half", "1.5", ""])
def test_tiles_that_are_none(text: str) -> None:
    with pytest.raises(UsageError, match="--tile is auto or a width"):
        choose_detail(Upsampling.GUIDED, text, None)


def test_what_is_written_counts() -> None:
    npy, preview, ply = (f.facts.use_bytes for f in (Format.NPY, Format.PREVIEW, Format.PLY))
    formats = [npy], [npy, preview], [preview, ply]
    taken = [choose_detail(Upsampling.GUIDED, None, None, f).use_bytes for f in formats]
    assert taken == sorted(set(taken))
    beside = choose_detail(Upsampling.GUIDED, None, None, [preview], side_by_side=True)
    assert beside.use_bytes > taken[1]


def test_pictures_that_cannot_fit_are_not_decoded() -> None:
    gray = bytes_needed(640, 480, Detail(use_bytes=13), 640 * 480)
    for limit, problem in (
        (
            PictureLimit(640 * 480 - 1),
            "more than 307,199; raise --max-pixels if you trust the file",
        ),
        (PictureLimit(10**9, Detail(max_memory_bytes=10, use_bytes=13)), "need 13M, more than"),
        (PictureLimit(10**9, Detail(max_memory_bytes=gray - 1, use_bytes=13)), "raise it to 13M"),
    ):
        with pytest.raises(InputError, match=f"640×480 pixels.*{problem}"):
            limit.check("a.png", 640, 480)
    PictureLimit(640 * 480, Detail(max_memory_bytes=gray, use_bytes=13)).check("a.png", 640, 480)


def test_a_limit_is_named_as_it_was_given() -> None:
    sizes = (10, 200_000, 1_500_000_000, 800_000_000, 1_000)
    assert list(map(size_text, sizes)) == ["10", "200K", "1.5G", "800M", "1K"]


def test_the_size_that_a_refusal_names_is_enough(inside: Cli) -> None:
    """And a little less is not, so that nobody raises it in the dark or further than needed."""
    picture = write_picture(inside.folder / "room.png", np.zeros((480, 640, 3), np.uint8))
    for limit in ("10", "9M"):
        done = inside("predict", picture, "-o", "d.png", "--max-memory", limit)
        (line,) = done.stderr.decode().splitlines()
        assert f"more than --max-memory {limit}; raise it to 13M " in line
        assert "--max-pixels" not in line
    assert inside("predict", picture, "-o", "d.png", "--max-memory", "12M").returncode == 1
    assert inside("predict", picture, "-o", "d.png", "--max-memory", "13M").returncode == 0


@pytest.mark.parametrize("name", ["predict", "batch", "video"])
def test_commands_have_the_options_that_their_page_names(name: str) -> None:
    page = (DOCS / "sharpness.md").read_text()
    own = {word for parameter in shell.load_command(name).params for word in parameter.opts}
    for option in ("--upsample", "--tile", "--max-memory"):
        assert option in own
        assert f"`{option}`" in page


@pytest.mark.parametrize("command", ["predict", "batch", "video"])
def test_every_command_bounds_memory(inside: Cli, command: str) -> None:
    folder = inside.folder / "in"
    picture = write_picture(folder / "room.png")
    if command == "video":
        picture = write_mp4(inside.folder / "clip.mp4", flat_frames([100, 120]))
    out = ("--out", "out/") if command != "predict" else ("-o", "out/")
    done = inside(command, folder if command == "batch" else picture, *out, "--max-memory", "100K")
    assert done.returncode == 1
    assert b"--max-memory" in done.stderr
    done = inside(command, folder if command == "batch" else picture, *out, "--max-memory", "10M")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("option", [("--tile", "x"), ("--upsample", "cubic"), ("--tile", "0")])
def test_wrong_words(inside: Cli, option: tuple[str, str]) -> None:
    write_picture(inside.folder / "room.png")
    done = inside("predict", "room.png", *option)
    assert done.returncode == 2
    assert not list(inside.folder.glob("*.depth.png"))


def peak_bytes(cli: Cli, *arguments: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", PEAK, *cli.command("predict", *arguments)],
        capture_output=True,
        cwd=cli.folder,
        env=cli.environment,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout) * 1024


@pytest.mark.skipif(sys.platform != "linux", reason="counts kilobytes as Linux does")
@pytest.mark.parametrize("written", ["npy", "png16", "preview"])
def test_the_process_stays_within_the_limit(inside: Cli, written: str) -> None:
    write_picture(inside.folder / "small.png")
    pixels = np.repeat(np.arange(WIDTH) * 255 // WIDTH, 3).reshape(1, WIDTH, 3).astype(np.uint8)
    write_picture(inside.folder / "large.png", np.repeat(pixels, HEIGHT, axis=0))
    options = "--format", written, "--tile", "auto", "--threads", "1"
    use = choose_detail(Upsampling.GUIDED, None, None, [Format(written).facts.use_bytes]).use_bytes
    limit = HEIGHT * WIDTH * (3 + 4 + use) + 64 * BAND_PIXELS + 1_000_000
    refused = inside("predict", "large.png", *options, "--max-memory", str(limit - 2_000_000))
    assert refused.returncode == 1
    before = peak_bytes(inside, "small.png", *options)
    peak = peak_bytes(inside, "large.png", *options, "--max-memory", str(limit))
    assert HEIGHT * WIDTH * 7 < peak - before < limit


def test_tiles_change_the_map_but_not_its_size(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    for name, options in (("a", ()), ("b", ("--tile", "auto")), ("c", ("--upsample", "bilinear"))):
        assert inside("predict", "room.png", "-o", f"{name}.npy", *options).returncode == 0
    maps = [np.load(inside.folder / f"{name}.npy") for name in "abc"]
    assert {m.shape for m in maps} == {(48, 64)}
    assert all(np.abs(maps[0] - other).max() > 1e-3 for other in maps[1:])
