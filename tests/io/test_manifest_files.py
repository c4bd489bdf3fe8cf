"""Which files of an output folder hold rows of what."""

from __future__ import annotations

from pathlib import Path

import pytest

from depthcli.io.manifest.files import is_journal, is_of
from depthcli.io.manifest.shard import Shard


@pytest.mark.parametrize(
    ("name", "of_all", "of_the_second", "journal"),
    [
        ("manifest.jsonl", True, False, False),
        ("manifest.parquet", True, False, False),
        (".depthcli-batch.jsonl", True, False, True),
        ("manifest-2-of-3.jsonl", True, True, False),
        (".depthcli-batch-2-of-3.jsonl", True, True, True),
        (".depthcli-batch-1-of-3.jsonl", True, False, True),
        ("manifest-2-of-4.jsonl", True, False, False),
        ("manifest.txt", False, False, False),
        ("my manifest.jsonl", False, False, False),
    ],
)
def test_names_tell_whose_rows_are_in_a_file(
    name: str, of_all: bool, of_the_second: bool, journal: bool
) -> None:
    path = Path("out") / name
    assert (is_of(path, Shard()), is_of(path, Shard(2, 3))) == (of_all, of_the_second)
    assert is_journal(path) == journal
