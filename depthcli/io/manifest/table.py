"""Rows of a manifest in Parquet, with names that are not UTF-8 escaped."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from depthcli.io.manifest.row import Origin, Row, row_of
from depthcli.io.parquet import write_table
from depthcli.io.storage.atomic_folder import atomic_folder

_COLUMNS = {
    "input": str,
    "status": str,
    "outputs": [{"path": str, "bytes": int, "sha256": str}],
    "seconds": float,
    "input_sha256": str,
    "input_path": str,
    "error": str,
    "warnings": [str],
    "camera": str,
    "anchors": {"given": int, "used": int, "residual_m": float, "sha256": str},
    **dict.fromkeys(Origin.__slots__, str),
}
_ESCAPED = re.compile(r"\\u(d[89a-f][0-9a-f]{2})")


def write_rows(folder: Path, rows: Iterable[Row]) -> None:
    """Write a manifest in Parquet files, in place of one that is there.

    Raises:
        OutputError: it cannot be written; what was there stays.
    """
    with atomic_folder(folder) as temporary:
        write_table(temporary, _COLUMNS, (_utf8(row.as_json()) for row in rows))


def parsed_table_row(fields: dict[str, Any]) -> Row | None:
    """A row from the values of its columns; None if they are not those of a row."""
    return row_of(_with_texts(fields, unescaped))


def unescaped(text: str) -> str:
    """A text with its escapes undone."""
    return _ESCAPED.sub(lambda found: chr(int(found[1], 16)), text) if "\\u" in text else text


def _utf8(value: Any) -> Any:  # noqa: ANN401 - what JSON can hold
    """The same, with texts whose bytes are not UTF-8 escaped as in JSON."""
    return _with_texts(value, lambda text: text.encode("utf-8", "backslashreplace").decode())


def _with_texts(value: Any, change: Callable[[str], str]) -> Any:  # noqa: ANN401 - what JSON can hold
    """The same, with all texts changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {name: _with_texts(part, change) for name, part in value.items()}
    if isinstance(value, Sequence):
        return [_with_texts(part, change) for part in value]
    return value
