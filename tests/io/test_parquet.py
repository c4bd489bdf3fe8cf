"""Lists of inputs in Parquet files."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from depthcli.errors import UsageError
from depthcli.io.listing.path_list import column_texts


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
    with pytest.raises(UsageError):
        column_texts(tmp_path / "a.parquet", None)


def test_a_folder_without_tables(tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        column_texts(tmp_path, None)
    with pytest.raises(FileNotFoundError):
        column_texts(tmp_path / "none.parquet", None)
