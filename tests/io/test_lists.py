"""Lists of inputs in tables."""

from __future__ import annotations

import builtins
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from depthcli.errors import UsageError
from depthcli.io.listing.folder import InputFile
from depthcli.io.listing.path_list import listed_inputs, read_list

if TYPE_CHECKING:
    from collections.abc import Callable

WORDS = ["hall/a.png", "s3://bucket/b c,d.jpg", "é.png"]


def parquet(path: Path, /, **columns: list[Any]) -> Path:
    pq.write_table(pa.table(columns), path, row_group_size=2)
    return path


def csv(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_text(text, encoding=encoding)
    return path


def test_paths_of_a_list_of_a_store_are_not_those_of_local_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.jpg").touch()
    monkeypatch.chdir(tmp_path)
    assert list(listed_inputs(["a.jpg"], "s3://photos/in")) == [
        InputFile("a.jpg", "s3://photos/in/a.jpg")
    ]


@pytest.mark.parametrize(
    ("write", "column"),
    [
        (lambda f: parquet(f / "l.parquet", path=WORDS, size=[1, 2, 3]), None),
        (lambda f: parquet(f / "l.parquet", uri=WORDS, path=["", "", ""]), "uri"),
        (lambda f: parquet(f / "l.PARQUET", uri=WORDS), None),
        (lambda f: parquet(f / "l.parquet", uri=pa.array(WORDS).dictionary_encode()), None),
        (lambda f: parquet(f / "l.parquet", uri=[WORDS[0], None, *WORDS[1:], ""]), None),
        (
            lambda f: csv(f / "l.csv", 'n,path\n1,hall/a.png\n2,"s3://bucket/b c,d.jpg"\n3,é.png'),
            None,
        ),
        (
            lambda f: csv(f / "l.tsv", "\ufeffuri\nhall/a.png\ns3://bucket/b c,d.jpg\né.png\n\n"),
            None,
        ),
    ],
)
def test_a_column_of_paths(
    tmp_path: Path, write: Callable[[Path], Path], column: str | None
) -> None:
    assert list(read_list(str(write(tmp_path)), column)) == WORDS


def test_a_folder_of_parquet_files_is_read_in_the_order_of_names(tmp_path: Path) -> None:
    folder = tmp_path / "set.parquet"
    folder.mkdir()
    parquet(folder / "part-1.parquet", path=WORDS[2:])
    parquet(folder / "part-0.parquet", path=WORDS[:2])
    assert list(read_list(str(folder))) == WORDS


@pytest.mark.parametrize(
    ("write", "column"),
    [
        (lambda f: parquet(f / "l.parquet", a=["x"], b=["y"]), None),
        (lambda f: parquet(f / "l.parquet", a=["x"]), "b"),
        (lambda f: parquet(f / "l.parquet", a=[1]), None),
        (lambda f: csv(f / "l.parquet", ""), None),
        (lambda f: csv(f / "l.parquet", "PAR1"), None),
        (lambda f: csv(f / "l.csv", ""), None),
        (lambda f: csv(f / "l.csv", "a,b\n1,2\n"), "c"),
        (lambda f: csv(f / "l.csv", "path,depth\na.png,2,35\n"), None),
        (lambda f: csv(f / "l.csv", f"a\nb.png\n{'c' * 200_000}\nd.png\n"), None),
        (lambda f: csv(f / "l.txt", "a.png\n"), "c"),
        (lambda f: csv(f / "l.csv", "path\na.png\n", "utf-16"), None),
        (lambda f: csv(f / "l.txt", "a.png\n", "utf-16"), None),
        (lambda f: f / "missing.parquet", None),
        (lambda f: f / "missing.csv", None),
    ],
)
def test_lists_that_cannot_be_used(
    tmp_path: Path, write: Callable[[Path], Path], column: str | None
) -> None:
    with pytest.raises(UsageError):
        list(read_list(str(write(tmp_path)), column))


def test_a_list_without_rows_names_nothing(tmp_path: Path) -> None:
    assert (
        list(read_list(str(parquet(tmp_path / "l.parquet", path=pa.array([], pa.string()))))) == []
    )
    assert list(read_list(str(csv(tmp_path / "l.csv", "path\n")))) == []


def test_without_pyarrow_one_line_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = parquet(tmp_path / "l.parquet", path=WORDS)
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UsageError):
        read_list(str(path))


def test_a_byte_order_mark_is_no_part_of_a_name(tmp_path: Path) -> None:
    assert list(read_list(str(csv(tmp_path / "l.txt", "\ufeffa.png\r\nb.png\r\n")))) == [
        "a.png",
        "b.png",
    ]


def test_a_file_uri_is_the_path_that_it_names(tmp_path: Path) -> None:
    plain = tmp_path / "in" / "a b.png"
    uri = plain.as_uri()
    assert uri.startswith("file:///")
    as_uri, as_path = (next(iter(listed_inputs([w], str(tmp_path)))) for w in (uri, str(plain)))
    assert as_uri == as_path
    assert as_uri.name == "in/a b.png"


def test_a_table_keeps_every_byte_of_a_name(tmp_path: Path) -> None:
    path = tmp_path / "l.csv"
    path.write_bytes(b'n,path\n1,"a\r\nb\rc.png"\n2\n3,\n\n4,caf\xe9.png\n')
    assert list(read_list(str(path))) == ["a\r\nb\rc.png", os.fsdecode(b"caf\xe9.png")]
