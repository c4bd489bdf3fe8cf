"""``depthcli bench``."""

import json
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
