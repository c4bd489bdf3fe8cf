"""Rows of a manifest as rows of a table, whose texts are UTF-8 whatever bytes a name has."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from depthcli.io.manifest.row import Origin, Row, row_of
from depthcli.io.parquet import write_table
from depthcli.io.storage.atomic_folder import folder_in_place

_COLUMNS = {
    "input": str,
    "status": str,
    "outputs": [{"path": str, "bytes": int, "sha256": str}],
    "seconds": float,
    "input_sha256": str,
    "error": str,
    "warnings": [str],
    "camera": str,
    **dict.fromkeys(Origin.__slots__, str),
}
_ESCAPED = re.compile(r"\\u(d[89a-f][0-9a-f]{2})")


def write_rows(folder: Path, rows: Iterable[Row]) -> None:
    """Write a manifest in Parquet files, in place of one that is there.

    Raises:
        OutputError: it cannot be written; what was there stays.
    """
    with folder_in_place(folder) as temporary:
        write_table(temporary, _COLUMNS, (_utf8(row.as_json()) for row in rows))


def parsed_table_row(fields: dict[str, Any]) -> Row | None:
    """A row from the values of its columns; None if they are somebody else's."""
    return row_of(_changed(fields, plain_text))


def plain_text(text: str) -> str:
    """A text as it was before it was written."""
    return _ESCAPED.sub(lambda found: chr(int(found[1], 16)), text) if "\\u" in text else text


def _utf8(value: Any) -> Any:  # noqa: ANN401 - what JSON can hold
    """The same, with texts whose bytes are not UTF-8 escaped as in JSON."""
    return _changed(value, lambda text: text.encode("utf-8", "backslashreplace").decode())


def _changed(value: Any, change: Callable[[str], str]) -> Any:  # noqa: ANN401 - what JSON can hold
    """The same, with all texts changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {name: _changed(part, change) for name, part in value.items()}
    if isinstance(value, Sequence):
        return [_changed(part, change) for part in value]
    return value
