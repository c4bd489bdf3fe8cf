"""Rows of a batch, and the file that they are safe in."""

import os
from pathlib import Path

import pytest
from helpers.batches import row
from helpers.file_trees import contents
from hypothesis import given, strategies as st

from depthcli.errors import OutputError, UsageError
from depthcli.io.manifest import Journal, Rows, known_rows, parse_row, row_files

JOURNAL_NAME = ".depthcli-batch.jsonl"
MANIFEST_NAME = "manifest.jsonl"


@given(st.binary() | st.integers(0, 999).map(lambda end: row("a").as_line()[:end]))
def test_line_that_is_not_a_row_is_none(line: bytes) -> None:
    assert parse_row(line) in (None, row("a"))


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError):
        Journal(tmp_path / "file" / "out")


def test_an_empty_manifest_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "manifest.jsonl").touch()
    Journal(tmp_path).finish([])


def test_a_manifest_of_another_program_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / MANIFEST_NAME).write_bytes(b'{"audio": "x.wav"}\n')
    before = contents(tmp_path)
    for opened in (Journal, known_rows):
        with pytest.raises(UsageError):
            opened(tmp_path)
    assert contents(tmp_path) == before


def test_a_manifest_that_cannot_be_written_loses_nothing(tmp_path: Path) -> None:
    (tmp_path / MANIFEST_NAME).write_bytes(row("a").as_line())
    journal = Journal(tmp_path)
    journal.add(row("b"))
    journal.manifest = tmp_path / MANIFEST_NAME / "manifest.jsonl"
    with pytest.raises(OutputError):
        journal.finish(["b"])
    journal._opened.close()
    assert list(known_rows(tmp_path)) == [row("a"), row("b")]


def test_the_latest_file_of_rows_is_the_last(tmp_path: Path) -> None:
    names = ["manifest.jsonl", "manifest-1-of-3.jsonl", "manifest-2-of-4.jsonl"]
    names += [".depthcli-batch-3-of-3.jsonl", ".depthcli-batch.jsonl"]
    for age, name in enumerate([*names, "manifest.txt", "manifesto.jsonl"]):
        (tmp_path / name).write_bytes(row("a", seconds=age).as_line())
        os.utime(tmp_path / name, (age, age))
    assert [path.name for path in row_files(tmp_path)] == names
    assert known_rows(tmp_path).row("a") == row("a", seconds=4)


def test_a_file_that_vanishes_is_passed_over(tmp_path: Path) -> None:
    """As the journal of another shard that has just ended."""
    assert not Rows([tmp_path / JOURNAL_NAME]).has_files
