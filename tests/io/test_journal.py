"""Rows of a batch, and the file that they are safe in."""

import os
import threading
from pathlib import Path

import pytest
from helpers.file_trees import contents
from hypothesis import given
from hypothesis import strategies as st

from depthcli.errors import OutputError, UsageError
from depthcli.io.manifest import (
    FAILED,
    OK,
    CacheKey,
    Journal,
    ManifestRow,
    OutputFile,
    Rows,
    Shard,
    checksum,
    is_intact,
    known_rows,
    output_entry,
    parse_row,
    row_files,
)

JOURNAL_NAME = ".depthcli-batch.jsonl"
MANIFEST_NAME = "manifest.jsonl"
ORIGIN = CacheKey("0" * 64, "tiny", "1" * 64, "1.0")


def row(name: str, seconds: float = 0.5) -> ManifestRow:
    outputs = (OutputFile(f"{name}.depth.png", 12, "2" * 64),)
    return ManifestRow(name, OK, ORIGIN, outputs, seconds, "3" * 64, warnings=("far",))


def test_a_row_is_read_back() -> None:
    for found in (row("a.png"), ManifestRow("b.png", FAILED, ORIGIN, error="is empty")):
        line = found.as_line()
        assert line.endswith(b"\n")
        assert parse_row(line) == found


@given(st.text(st.characters(categories=["L", "Cs", "Cc", "P"])))
def test_a_row_of_any_name_is_one_line_of_ascii(name: str) -> None:
    line = row(name).as_line()
    assert line.isascii()
    assert line.count(b"\n") == 1
    found = parse_row(line)
    assert found.input == name


@given(st.binary() | st.integers(0, 300).map(lambda end: row("a").as_line()[:end]))
def test_line_that_is_not_a_row_is_none(line: bytes) -> None:
    assert parse_row(line) in (None, row("a"))


@pytest.mark.parametrize(
    "line", [b"[]", b"3", b"null", b'{"input": "a"}', b'{"outputs": [[]]}', b'{"a": "\\ud800"}']
)
def test_somebody_else_s_json_is_none(line: bytes) -> None:
    assert parse_row(line) is None


def test_an_output_is_intact_until_it_changes(tmp_path: Path) -> None:
    path = tmp_path / "hall" / "a.png"
    path.parent.mkdir()
    path.write_bytes(b"depth")
    file = output_entry(tmp_path, path)
    assert (file.path, file.bytes) == ("hall/a.png", 5)
    assert is_intact(tmp_path, file)
    os.mkfifo(tmp_path / "pipe")
    assert checksum(tmp_path / "pipe") is None  # and is not waited for
    path.write_bytes(b"dept!")
    assert not is_intact(tmp_path, file)
    path.unlink()
    assert not is_intact(tmp_path, file)
    with pytest.raises(OutputError):
        output_entry(tmp_path, path)


def test_rows_become_the_manifest_in_the_order_of_the_inputs(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "new" / "out")
    for name in ("c", "a", "b", "a"):
        journal.add(row(name, seconds=0.25))
    journal.add(row("a", seconds=1.5))
    journal.finish(["a", "b", "c", "missing"])
    assert [path.name for path in (tmp_path / "new" / "out").iterdir()] == [MANIFEST_NAME]
    lines = (tmp_path / "new" / "out" / MANIFEST_NAME).read_bytes().splitlines()
    found = [parse_row(line) for line in lines]
    assert found == [row("a", 1.5), row("b", 0.25), row("c", 0.25)]


def test_a_killed_batch_leaves_its_rows(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    journal.add(row("a"))
    journal._opened.close()  # as the end of the process does
    with (tmp_path / JOURNAL_NAME).open("ab") as file:
        file.write(row("b").as_line()[:40])
    assert known_rows(tmp_path).row("a") == row("a")
    again = Journal(tmp_path)
    assert (again.row("a"), again.row("b")) == (row("a"), None)
    again.add(row("c"))
    again.finish(["a", "b", "c"])
    known = known_rows(tmp_path)
    assert [known.row(name) for name in "abc"] == [row("a"), None, row("c")]


def test_known_rows_of_nothing() -> None:
    assert known_rows(Path("nowhere")).row("a") is None


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError):
        Journal(tmp_path / "file" / "out")


def test_threads_lose_no_row(tmp_path: Path) -> None:
    journal = Journal(tmp_path)

    def add(start: int) -> None:
        for number in range(start, 200, 4):
            journal.add(row(str(number)))
            assert journal.row(str(number)) == row(str(number))

    threads = [threading.Thread(target=add, args=(start,)) for start in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    journal.finish(map(str, range(200)))
    assert (tmp_path / MANIFEST_NAME).read_bytes().count(b"\n") == 200


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


def test_a_shard_reads_its_rows_and_those_of_inputs_outside_the_batch(tmp_path: Path) -> None:
    names = list("abcdefgh")
    for number in (1, 2):
        held = filter(Shard(number, 2).holds, names)
        lines = b"".join(row(name).as_line() for name in held)
        (tmp_path / f"manifest-{number}-of-2.jsonl").write_bytes(lines)
    batch, shard = names[:6], Shard(1, 2)
    rows = known_rows(tmp_path, shard, batch)
    held = {name for name in batch if shard.holds(name)}
    assert 0 < len(held) < len(batch)
    assert {each.input for each in rows} == held | {"g", "h"}
    assert {each.input for each in rows.others} == {"g", "h"}
    journal = Journal(tmp_path, shard, batch)
    journal.finish(batch)
    assert {each.input for each in Rows([journal.manifest])} == set(filter(shard.holds, names))


def test_a_file_that_vanishes_is_passed_over(tmp_path: Path) -> None:
    """As the journal of another shard that has just ended."""
    assert not Rows([tmp_path / JOURNAL_NAME]).has_files
