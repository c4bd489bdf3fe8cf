"""A batch that goes wrong stops early, says why, and goes on when it is asked again."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import request
from helpers.command_line import Cli
from helpers.tiny import synthetic_picture, write_picture

from depthcli.io.manifest import OK, parse_row
from depthcli.jobs.batch.run import Batch

GOOD, BAD, LATE = ("a", "b"), 100, ("x", "y", "z")
AHEAD = 64  # inputs that a worker can be ahead of what is told


def half_good(folder: Path) -> None:
    """Good pictures before and after a stretch of empty files."""
    for number, name in enumerate((*GOOD, *LATE)):
        write_picture(folder / "in" / f"{name}.png", synthetic_picture(24, 32 + number))
    for number in range(BAD):
        (folder / "in" / f"m{number:03}.png").touch()


def ended(folder: Path, budget: int | None) -> Batch:
    """A batch by one worker, at its end."""
    batch = Batch(replace(request(folder), workers=1, max_failures=budget))
    for _ in batch:
        pass
    return batch


def test_the_first_failure_beyond_the_budget_stops(tmp_path: Path) -> None:
    half_good(tmp_path)
    batch = ended(tmp_path, 3)
    told = [name for name, _ in batch.tally.failures][:4]
    assert told == ["m000.png", "m001.png", "m002.png", "m003.png"]
    assert batch.stopped
    lines = (tmp_path / "out" / "manifest.jsonl").read_bytes().splitlines()
    rows = [row for row in map(parse_row, lines) if row]
    assert len(rows) == batch.tally.completed <= 2 + 4 + AHEAD
    done = {row.input for row in rows if row.status == OK}
    assert {"a.png", "b.png"} <= done  # and what a worker was at
    again = ended(tmp_path, 3)
    assert again.tally.kept >= len(done)
    assert again.stopped == batch.stopped
    for path in (tmp_path / "in").glob("m*"):
        path.unlink()
    last = ended(tmp_path, 3)
    assert last.tally.kept >= len(done)
    assert (last.tally.completed, last.tally.failures, last.stopped) == (5, [], None)


@pytest.mark.parametrize("budget", [BAD, None])
def test_batch_within_failure_budget_continues(tmp_path: Path, budget: int | None) -> None:
    half_good(tmp_path)
    batch = ended(tmp_path, budget)
    assert batch.stopped is None
    assert (batch.tally.completed, len(batch.tally.failures)) == (batch.tally.total, BAD)


def test_nothing_is_stopped_by_the_last_input(tmp_path: Path) -> None:
    for name in GOOD:
        write_picture(tmp_path / "in" / f"{name}.png")
    (tmp_path / "in" / "c.png").touch()
    batch = ended(tmp_path, 0)
    assert (batch.stopped, batch.tally.completed, len(batch.tally.failures)) == (None, 3, 1)


def test_the_command_says_why_it_stopped(inside: Cli) -> None:
    half_good(inside.folder)
    done = inside("batch", "in", "--out", "out", "--max-failures", "0", "--workers", "1")
    assert done.returncode == 1
    assert b"more than 0" in done.stderr
    assert b" of 105 inputs done" in done.stdout
    again = inside("batch", "in", "--out", "out", "--max-failures", "100", "--quiet")
    assert (again.returncode, b"stopped" in again.stderr) == (1, False)
