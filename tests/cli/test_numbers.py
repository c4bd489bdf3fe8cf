"""Numbers at the edges are a usage error that names the option, and nothing is written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from helpers.tiny import write_picture

if TYPE_CHECKING:
    from helpers.command_line import Cli

DIGITS = "9" * 5000


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ("predict a.png --threads 2147483648", "--threads"),
        (f"predict a.png --threads {DIGITS}", "--threads"),
        (f"predict a.png --tile {DIGITS}", "--tile"),
        ("predict a.png --png-scale 1e-300", "--png-scale"),
        ("predict a.png --png-scale 1e300", "--png-scale"),
        ("predict a.png --png-scale nan", "--png-scale"),
        ("predict a.png --hfov 1e-300", "--hfov"),
        ("predict a.png --hfov 179.999999999", "--hfov"),
        (f"predict a.png --focal-px {DIGITS}", "--focal-px"),
        ("predict a.png --focal-px 1e-300", "--focal-px"),
        ("predict a.png --focal-px 1e300", "--focal-px"),
        ("convert a.npy a.ply --focal-px 1e30", "--focal-px"),
        ("predict a.png --anchor 3,4,1e-300", "--anchor"),
        ("predict a.png --anchor 3,4,1e300", "--anchor"),
        ("predict a.png --format preview --vmin -1e308 --vmax 1e308", "--vmin"),
        ("batch . --out out --batch-size 9223372036854775808", "--batch-size"),
        ("batch . --out out --workers 2147483648", "--workers"),
        ("batch . --out out --include []", "'[]' is not a valid pattern"),
        (f"video a.mkv --out out --start {DIGITS}f", "--start"),
        (f"video a.mkv --out out --every {DIGITS}", "--every"),
        ("video a.mkv --out out --start-number 99999999999999999999", "--start-number"),
        ("bench --seconds 1e300", "--seconds"),
        (f"bench --size {DIGITS}x9", "--size"),
        (f"render rooms --out out --size 9x{DIGITS}", "--size"),
    ],
)
def test_a_number_that_cannot_be_meant_is_refused(inside: Cli, words: str, option: str) -> None:
    write_picture(inside.folder / "a.png")
    done = inside(*words.split())
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.decode().splitlines()
    assert option in line
    assert [path.name for path in inside.folder.iterdir()] == ["a.png"]
