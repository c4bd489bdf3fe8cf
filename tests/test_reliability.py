"""docs/reliability.md names tests that there are."""

import ast
import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "docs" / "reliability.md").read_text("utf-8")
NAMED = re.findall(r"`((?:\w+/)*test_\w+\.py)(?:::(\w+))?`", PAGE.replace("`tests/", "`"))
COMMANDS = re.findall(r"^\| `(\w+\.py)", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("file", "name"), sorted(set(NAMED)))
def test_every_test_named_in_the_docs_exists(file: str, name: str) -> None:
    found = ast.parse((TESTS / file).read_text("utf-8")).body
    functions = {node.name for node in found if isinstance(node, ast.FunctionDef)}
    assert not name or name in functions


def test_every_promise_has_a_test() -> None:
    promises = PAGE.split("## Promises")[1].split("\n## ")[0].splitlines()[4:-1]
    assert len(promises) > 20
    assert all(re.search(r"::test_|\.py`|\(#", line.split("|")[2]) for line in promises)


def test_the_long_commands_are_there() -> None:
    assert COMMANDS
    assert all((TESTS.parent / "robustness" / name).is_file() for name in COMMANDS)
