"""``depthcli bench``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from helpers.command_line import Cli

QUICK = ("--seconds", "0.05", "--provider", "cpu")


def test_measures_add_up(inside: Cli) -> None:
    done = inside("bench", *QUICK, "--size", "1200x900", "--workers", "2", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    for latency in (found["network"], found["end_to_end"]):
        assert 0 < latency["min_ms"] <= latency["median_ms"]
        assert latency["noise"] >= 0
        assert latency["runs"] >= 5
    assert found["pictures_per_s"] > 0
    assert found["peak_memory_mb"] > 30
    assert (found["workers"], found["provider"]) == (2, "cpu")
    assert len(found["model_sha256"]) == 64


def test_a_picture_of_ones_own(inside: Cli, picture: Path) -> None:
    done = inside("bench", *QUICK, picture)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.decode().splitlines()
    assert [line.split("  ")[0] for line in lines[1:]] == [
        *("network", "end-to-end", "throughput", "peak memory")
    ]


def test_a_terminal_is_told_how_long_it_takes(cli: Cli) -> None:
    code, shown = cli.on_a_terminal("bench", "--seconds", "0.2", "--size", "64x48")
    assert code == 0
    assert shown.splitlines()[0] == "measuring for about 1 s"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--size", "640"), 2, "WIDTHxHEIGHT"),
        (("--size", "0x10"), 2, "1 to 20000"),
        (("missing.jpg",), 1, "missing.jpg"),
        ((__file__,), 1, "test_bench.py is not a picture"),
        (("--seconds", "nan"), 2, "must be 0 or greater"),
        (("--model", "nothing"), 3, "nothing"),
        (("--provider", "tensorrt"), 3, "tensorrt"),
    ],
)
def test_failures_are_one_line(
    inside: Cli, arguments: tuple[str, ...], code: int, words: str
) -> None:
    done = inside("bench", *arguments)
    assert done.returncode == code
    (line,) = done.stderr.decode().splitlines()
    assert words in line
    assert not done.stdout
