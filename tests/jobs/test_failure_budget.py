"""A batch that goes wrong stops early, says why, and goes on when it is asked again."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from helpers.batches import request
from helpers.tiny import synthetic_picture, write_picture

from depthcli.errors import UsageError
from depthcli.io.manifest.files import OK, CacheKey, ManifestRow, parse_row
from depthcli.jobs.batch.run import Batch, FailureBudget, Tally
from depthcli.jobs.batch.tasks import BatchResult

if TYPE_CHECKING:
    from pathlib import Path

    from helpers.command_line import Cli

GOOD, BAD, LATE = ("a", "b"), 100, ("x", "y", "z")
AHEAD = 64  # inputs that a worker can be ahead of what is told


def half_good(folder: Path) -> None:
    """Good pictures before and after a stretch of empty files."""
    for number, name in enumerate((*GOOD, *LATE)):
        write_picture(folder / "in" / f"{name}.png", synthetic_picture(24, 32 + number))
    for number in range(BAD):
        (folder / "in" / f"m{number:03}.png").touch()


def ended(folder: Path, budget: str | None) -> Batch:
    """A batch by one worker, at its end."""
    allowed = None if budget is None else FailureBudget.parse(budget)
    batch = Batch(replace(request(folder), workers=1, budget=allowed))
    for _ in batch:
        pass
    return batch


@pytest.mark.parametrize("budget", ["3", "3%"])
def test_the_first_failure_beyond_the_budget_stops(tmp_path: Path, budget: str) -> None:
    half_good(tmp_path)
    batch = ended(tmp_path, budget)
    told = [name for name, _ in batch.tally.failures][:4]
    assert told == ["m000.png", "m001.png", "m002.png", "m003.png"]
    assert batch.stopped is not None
    assert batch.stopped.startswith(f"more than {budget} ")
    lines = (tmp_path / "out" / "manifest.jsonl").read_bytes().splitlines()
    rows = [row for row in map(parse_row, lines) if row]
    assert len(rows) == batch.tally.completed <= 2 + 4 + AHEAD
    done = {row.input for row in rows if row.status == OK}
    assert {"a.png", "b.png"} <= done  # and what a worker was at
    again = ended(tmp_path, budget)
    assert again.tally.kept >= len(done)
    assert again.stopped == batch.stopped
    for path in (tmp_path / "in").glob("m*"):
        path.unlink()
    last = ended(tmp_path, budget)
    assert last.tally.kept >= len(done)
    assert (last.tally.completed, last.tally.failures, last.stopped) == (5, [], None)


@pytest.mark.parametrize("budget", [str(BAD), "100%", None])
def test_batch_within_failure_budget_continues(tmp_path: Path, budget: str | None) -> None:
    half_good(tmp_path)
    batch = ended(tmp_path, budget)
    assert batch.stopped is None
    assert (batch.tally.completed, len(batch.tally.failures)) == (batch.tally.total, BAD)


def test_nothing_is_stopped_by_the_last_input(tmp_path: Path) -> None:
    for name in GOOD:
        write_picture(tmp_path / "in" / f"{name}.png")
    (tmp_path / "in" / "c.png").touch()
    batch = ended(tmp_path, "0")
    assert (batch.stopped, batch.tally.completed, len(batch.tally.failures)) == (None, 3, 1)


def test_a_share_is_one_of_the_last_hundred_that_were_worked_on() -> None:
    tally, budget = Tally(1000), FailureBudget.parse("2%")
    origin = CacheKey("0" * 64, "tiny", "1" * 64, "1.0")
    good, bad = (
        BatchResult(ManifestRow("a", OK, origin, error=error)) for error in (None, "is empty")
    )
    for result in (bad, bad, *[good] * 98):
        tally.add(result)
    assert budget.reason(tally) is None
    tally.add(replace(good, is_kept=True))  # took no work and tells nothing
    tally.add(bad)
    assert budget.reason(tally) is None  # the first has left the hundred
    tally.add(bad)
    assert budget.reason(tally) is None
    tally.add(bad)
    assert budget.reason(tally)
    assert FailureBudget(1).reason(tally)


@pytest.mark.parametrize("word", ["", "%", "-1", "1.5%", "101%", "many", "9" * 5000])
def test_invalid_failure_budget_is_refused(word: str) -> None:
    with pytest.raises(UsageError):
        FailureBudget.parse(word)


def test_the_command_says_why_it_stopped(inside: Cli) -> None:
    half_good(inside.folder)
    done = inside("batch", "in", "--out", "out", "--max-failures", "0", "--workers", "1")
    assert done.returncode == 1
    assert b"more than 0" in done.stderr
    assert b" of 105 inputs done" in done.stdout
    again = inside("batch", "in", "--out", "out", "--max-failures", "100", "--quiet")
    assert (again.returncode, b"stopped" in again.stderr) == (1, False)
