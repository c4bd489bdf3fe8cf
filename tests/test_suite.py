"""The suite itself: any of its files can be given beside any other."""

import re
from collections import Counter
from pathlib import Path

FILES = sorted(Path(__file__).parent.rglob("*.py"))


def test_no_test_imports_a_conftest() -> None:
    """Each folder has its own module of that name; the last one loaded would be imported."""
    shared = re.compile(r"^\s*(from|import) conftest\b", re.MULTILINE)
    assert [file for file in FILES if shared.search(file.read_text())] == []


def test_names_of_modules_are_unique() -> None:
    names = Counter(file.stem for file in FILES if file.stem != "conftest")
    assert [name for name, count in names.items() if count > 1] == []
