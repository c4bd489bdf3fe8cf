"""Tables that are larger than a group of rows, a file and a block: all of them are small here."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.errors import UsageError
from depthcli.io import parquet
from depthcli.io.manifest.files import open_rows, write_manifest
from depthcli.io.manifest.row import FAILED, OK, Origin, OutputFile, Row
from depthcli.io.parquet import Table, column_texts, write_table

GROUP, GROUPS, BLOCK = 4, 2, 3
COLUMNS = {"n": int, "x": float, "s": str, "l": [str], "d": [{"a": int, "b": str}]}
TEXTS = st.text(st.characters(categories=["L", "Cs", "Cc", "P"]), max_size=5)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "_GROUP_ROWS", GROUP)
    monkeypatch.setattr(parquet, "_PART_GROUPS", GROUPS)
    monkeypatch.setattr(parquet, "_BLOCK_ROWS", BLOCK)


def _values(number: int) -> dict[str, Any]:
    parts = [{"a": number, "b": f"b{number}"}] * (number % 3)
    some = {"n": number, "x": number / 4, "s": f"é{number}", "l": ["t"] * (number % 2), "d": parts}
    return some if number % 5 else dict.fromkeys(COLUMNS)


@pytest.mark.parametrize("count", [0, 1, 3, 4, 5, 8, 9, 23])
def test_rows_of_any_number_are_found_in_any_order(count: int, tmp_path: Path) -> None:
    rows = [_values(number) for number in range(count)]
    write_table(tmp_path, COLUMNS, iter(rows))
    files = sorted(path.name for path in tmp_path.iterdir())
    parts = max(1, -(-count // (GROUP * GROUPS)))
    assert files == [f"part-{number:05}.parquet" for number in range(parts)]
    sizes = [pq.ParquetFile(tmp_path / name).metadata.num_row_groups for name in files]
    assert sum(sizes) == -(-count // GROUP)
    assert max(sizes) <= GROUPS
    table = Table(tmp_path)
    for step in (1, -1, 5, 7):
        order = range(count)[::step]
        assert [table.row(number) for number in order] == [rows[number] for number in order]
    assert list(table.column("s")) == [row["s"] for row in rows]
    assert list(table.column("none")) == []
    table.close()
    assert all(file.closed for file in table._files)
    texts = [row["s"] for row in rows if row["s"]]
    assert list(column_texts(tmp_path, "s")) == texts


def test_a_row_is_read_from_its_block_alone(tmp_path: Path, monkeypatch: Any) -> None:
    write_table(tmp_path, {"n": int}, ({"n": number} for number in range(20)))
    table, read = Table(tmp_path), []
    real = pq.ParquetFile.read_row_group

    def counted(file: pq.ParquetFile, index: int) -> pa.Table:
        read.append(index)
        return real(file, index)

    monkeypatch.setattr(pq.ParquetFile, "read_row_group", counted)
    assert [table.row(number)["n"] for number in range(20)] == list(range(20))
    assert read == [0, 1, 0, 1, 0]


@st.composite
def rows(draw: st.DrawFn) -> list[Row]:
    names = draw(st.lists(TEXTS, unique=True, max_size=10))
    found = []
    for name in names:
        text = draw(TEXTS | st.none())
        files = draw(
            st.lists(st.builds(OutputFile, TEXTS, st.integers(0, 2**62), TEXTS), max_size=2)
        )
        status, seconds = draw(st.sampled_from([OK, FAILED])), draw(st.integers(0, 10**9)) / 10**6
        warnings, origin = draw(st.lists(TEXTS, max_size=2)), draw(st.builds(Origin, *[TEXTS] * 4))
        texts = {"error": text, "warnings": tuple(warnings), "camera": text, "input_path": text}
        row = Row(name, status, origin, tuple(files), seconds, text, **texts)
        found.append(row)
    return found


@settings(max_examples=25)
@given(rows(), st.sampled_from(["manifest.jsonl", "manifest.parquet"]))
def test_a_manifest_gives_back_what_was_put_into_it(made: list[Row], name: str) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        write_manifest(path, iter([Row("old", OK, Origin("", "", "", ""))]))
        write_manifest(path, iter(made))
        assert [found.name for found in path.parent.iterdir()] == [name]
        file = open_rows(path)
        places = dict(file.rows())
        assert list(places) == [row.input for row in made]
        assert [file.row(places[row.input]) for row in reversed(made)] == made[::-1]
        file.close()


@pytest.mark.parametrize(
    ("kind", "known"),
    [
        (pa.string(), True),
        (pa.large_string(), True),
        (pa.dictionary(pa.int8(), pa.string()), True),
        (pa.dictionary(pa.int8(), pa.int64()), False),
        (pa.binary(), False),
    ],
)
def test_texts_of_every_type(kind: pa.DataType, known: bool, tmp_path: Path) -> None:
    values = (
        [1, None] if kind.equals(pa.dictionary(pa.int8(), pa.int64())) else ["a", None, "", "b"]
    )
    array = (
        pa.array(values, kind.value_type)
        if pa.types.is_dictionary(kind)
        else pa.array(values, kind)
    )
    if pa.types.is_dictionary(kind):
        array = array.dictionary_encode()
    pq.write_table(pa.table({"other": array, "path": array}), tmp_path / "a.parquet")
    if known:
        assert list(column_texts(tmp_path / "a.parquet", None)) == ["a", "b"]
        return
    with pytest.raises(UsageError, match="not texts; name another one"):
        column_texts(tmp_path / "a.parquet", None)


def test_a_folder_without_tables(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=f"no .parquet file in {tmp_path}"):
        column_texts(tmp_path, None)
    with pytest.raises(FileNotFoundError):
        column_texts(tmp_path / "none.parquet", None)


def test_an_error_of_the_disk_stays_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="broken"), parquet._as_usage_error(tmp_path):
        raise OSError(5, "broken")
    line = "is not a complete Parquet file: of two lines; write it again"
    with pytest.raises(UsageError, match=line), parquet._as_usage_error(tmp_path):
        raise OSError("of two\n  lines")
