"""docs/reliability.md and reports.md name tests and commands that there are."""

import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "docs" / "reliability.md").read_text("utf-8")
REPORTS = (TESTS / "reports.md").read_text("utf-8")
NAMED = sorted(set(re.findall(r"`((?:\w+/)*test_\w+\.py)`", PAGE + REPORTS)))
COMMANDS = re.findall(r"`(\w+\.py)`", PAGE.split("## Robustness tests")[1].split("\n## ")[0])


@pytest.mark.parametrize("file", NAMED)
def test_every_test_named_in_the_docs_exists(file: str) -> None:
    assert (TESTS / file).is_file()


def test_every_promise_has_a_test() -> None:
    promises = PAGE.split("## Promises")[1].split("\n## ")[0].splitlines()[4:-1]
    assert len(promises) > 20
    assert all(re.search(r"\.py`|\(#", line.split("|")[2]) for line in promises)


def test_the_long_commands_are_there() -> None:
    assert COMMANDS
    assert all((TESTS.parent / "robustness" / name).is_file() for name in COMMANDS)
