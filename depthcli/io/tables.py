"""CSV tables, whose errors name line and column; the table of cameras, one row an image."""

import csv
import math
from collections.abc import Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from depthcli.core.camera import CENTRE_PX, FOCAL_PX, HFOV_DEG, UNKNOWN_CAMERA, Intrinsics
from depthcli.core.options import Rule, short_repr
from depthcli.errors import InputError, os_errors_as
from depthcli.io.storage.paths import read_regular


class CsvRow(NamedTuple):
    """A row of a table."""

    name: str  #: the table, for messages
    line: int  #: its last line, from 1
    cells: Mapping[str, str]  #: by column; "" where the row is too short

    def number(self, column: str, rule: Rule) -> float:
        """The number in a cell; NaN if it is empty."""
        word = self.cells[column]
        try:
            number = float(word or math.nan)
        except ValueError:
            number = None
        if number is None or not rule.holds(number):
            raise self.error(f"{column} is {rule.what}, not {short_repr(word)}")
        return number

    def error(self, problem: str) -> InputError:
        """The error to raise for a problem of this row."""
        return InputError(f"{self.name}, line {self.line}: {problem}")


class CsvTable:
    """A table in UTF-8; other bytes become surrogates, as in the names of files.

    Attributes:
        name: its own, for messages.
        columns: names of its columns, without spaces around them; none if it is empty.
    """

    def __init__(self, data: bytes, name: str, delimiter: str = ",") -> None:
        text = StringIO(data.decode("utf-8-sig", "surrogateescape"), newline="")
        self._lines = csv.reader(text, delimiter=delimiter, strict=True, skipinitialspace=True)
        self.name = name
        self.columns = [word.strip() for word in next(self._cells(), [])]

    def __iter__(self) -> Iterator[CsvRow]:
        """The rows after the first line that are not empty, once."""
        empty = dict.fromkeys(self.columns, "")
        for cells in filter(None, self._cells()):
            if len(cells) > len(self.columns):
                raise self._error(f"{len(cells)} values for {len(self.columns)} columns")
            named = dict(zip(self.columns, map(str.strip, cells), strict=False))
            yield CsvRow(self.name, self._lines.line_num, empty | named)

    def _cells(self) -> Iterator[list[str]]:
        try:
            yield from self._lines
        except csv.Error as error:
            raise self._error(str(error)) from error

    def _error(self, problem: str) -> InputError:
        return InputError(f"{self.name}, line {self._lines.line_num}: {problem}")


ID = "id"
_FOCAL = frozenset({"focal_px", "hfov_deg"})
_RULES = {"focal_px": FOCAL_PX, "hfov_deg": HFOV_DEG, "cx": CENTRE_PX, "cy": CENTRE_PX}
_MAX_BYTES = 256 * 2**20


def read_lenses(path: Path) -> dict[str, Intrinsics]:
    """The camera of each id.

    The first line names the columns: ``id``, and ``focal_px`` (pixels of the image), ``hfov_deg``
    (horizontal field of view in degrees) or both. In a row with both, ``focal_px`` counts. ``cx``
    and ``cy``, the principal point in pixels of the image, are optional. A row without any of
    these is left out. Other columns are ignored.
    """
    with os_errors_as(InputError, f"{path} cannot be read"):
        data = read_regular(path, _MAX_BYTES)
    table = CsvTable(data, str(path))
    if ID not in table.columns or _FOCAL.isdisjoint(table.columns):
        raise InputError(f"{path} has no columns id,focal_px or id,hfov_deg in its first line")
    lenses: dict[str, Intrinsics] = {}
    for row in table:
        focal_px, hfov_deg, cx, cy = (
            row.number(column, rule) if row.cells.get(column) else None
            for column, rule in _RULES.items()
        )
        if (cx is None) != (cy is None):
            raise row.error("give cx and cy, or neither")
        centre_px = None if cx is None or cy is None else (cx, cy)
        lens = Intrinsics(focal_px, None if focal_px is not None else hfov_deg, centre_px)
        if lens == UNKNOWN_CAMERA:
            continue
        name = row.cells[ID].removeprefix("./")
        if not name:
            raise row.error("the id is missing")
        if lenses.setdefault(name, lens) != lens:
            raise row.error(f"another row of {short_repr(name)} has another camera")
    return lenses
