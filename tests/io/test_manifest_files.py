"""Which files of an output folder hold rows of what."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.errors import OutputError, UsageError
from depthcli.io.manifest.files import (
    JsonRows,
    Shard,
    belongs_to,
    is_journal,
    journal_name,
    manifest_name,
    row_files,
)
from depthcli.io.manifest.journal import RowIndex, RowLocation, remove_path
from depthcli.io.manifest.row import ManifestFormat, Origin, Row


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
    assert (belongs_to(path, Shard()), belongs_to(path, Shard(2, 3))) == (of_all, of_the_second)
    assert is_journal(path) == journal


def test_rows_of_others_of_the_same_division_are_not_read(tmp_path: Path) -> None:
    names = [
        *("manifest.jsonl", "manifest-1-of-3.jsonl", "manifest-2-of-3.jsonl"),
        *("manifest-2-of-4.parquet", ".depthcli-batch-3-of-3.jsonl", ".depthcli-batch.jsonl"),
        *("manifest.txt", "manifesto.jsonl", ".depthcli-batch.jsonl.part"),
    ]
    for age, name in enumerate(reversed(names)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, ns=(0, age // 2))  # of two that are as old, by name
    (tmp_path / "manifest-9-of-9.jsonl").symlink_to("nowhere")
    of_all = [path.name for path in row_files(tmp_path, Shard())]
    assert of_all == [
        *(".depthcli-batch.jsonl", ".depthcli-batch-3-of-3.jsonl", "manifest-2-of-4.parquet"),
        *("manifest-1-of-3.jsonl", "manifest-2-of-3.jsonl", "manifest.jsonl"),
    ]
    others = {".depthcli-batch-3-of-3.jsonl", "manifest-1-of-3.jsonl"}
    of_the_second = [path.name for path in row_files(tmp_path, Shard(2, 3))]
    assert of_the_second == [name for name in of_all if name not in others]
    assert journal_name(Shard(2, 3)) == ".depthcli-batch-2-of-3.jsonl"
    assert manifest_name(Shard(), ManifestFormat.PARQUET) == "manifest.parquet"


def test_lines_that_are_no_rows_are_passed_over(tmp_path: Path) -> None:
    rows = [Row(name, "ok", Origin("", "", "", "")) for name in "abc"]
    path = tmp_path / "rows.jsonl"
    lines = [b"#\n", rows[0].as_line(), b"\n", rows[1].as_line(), rows[2].as_line()]
    path.write_bytes(b"".join(lines[:-1]) + b'{"input"')
    with path.open("ab", buffering=0) as end:
        file = JsonRows(path.open("rb"), end)
        assert dict(file.rows()) == {"a": 2, "b": len(b"".join(lines[:3]))}
        assert not file.ends_whole
        file.append(b"\n")
        place = file.append(lines[-1])
        assert place == path.stat().st_size - len(lines[-1])
        assert list(dict(file.rows())) == ["a", "b", "c"]
        assert file.ends_whole
        assert file.row(place) == rows[2]
        assert file.row(2) == rows[0]
        file.close()


@settings(max_examples=30)
@given(st.lists(st.tuples(st.text(max_size=3), st.integers(0, 3), st.integers(0, 9))))
def test_an_index_is_a_dictionary_in_two_orders(added: list[tuple[str, int, int]]) -> None:
    index, expected = RowIndex(), {}
    for name, *place in added:
        index.add([(name, RowLocation(*place))])
        expected[name] = RowLocation(*place)
    names = sorted(expected, key=lambda name: name.encode("utf-8", "surrogatepass"))
    assert list(index) == [expected[name] for name in names]
    assert list(index.in_file_order()) == sorted(expected.values())
    for name, place in expected.items():
        assert index.find(name) == place
        index.remove(name)
        assert index.find(name) is None
    assert list(index) == []


def test_an_index_without_room_is_one_clear_error() -> None:
    index = RowIndex()
    index._database.close()
    with pytest.raises(OutputError, match="set SQLITE_TMPDIR to a folder with room"):
        index.add([("a", RowLocation(0, 0))])


def test_files_and_folders_of_rows_are_removed(tmp_path: Path) -> None:
    (tmp_path / "folder" / "inner").mkdir(parents=True)
    (tmp_path / "file").touch()
    for name in ("folder", "file", "gone already"):
        remove_path(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "word", ["0/4", "5/4", "x", "1", "1/0", "-1/4", "1/4/4", "1.5/4", " 1/4", "", "²/4"]
)
def test_words_that_name_no_shard(word: str) -> None:
    with pytest.raises(UsageError, match="is not I/N with I from 1 to N"):
        Shard.parse(word)


def test_every_name_is_in_one_shard_for_ever() -> None:
    names = [f"hall/{number}.jpg" for number in range(3000)] + ["caf\udce9.png"]
    shards = [Shard.parse(f"{number}/4") for number in (1, 2, 3, 4)]
    held = Counter(shard.number for name in names for shard in shards if shard.holds(name))
    assert held.total() == len(names)
    assert max(held.values()) < 1.1 * min(held.values())
    # What is promised to those who divide lists themselves.
    known = {"a.png": 1, "hall/b.png": 4, "a.jpg": 3}
    for name, number in known.items():
        assert [shard.number for shard in shards if shard.holds(name)] == [number]
