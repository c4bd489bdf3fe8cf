"""CSV tables whose first line names the columns; errors name the line and the column."""

import csv
import math
from collections.abc import Iterator, Mapping
from io import StringIO
from typing import NamedTuple

from depthcli.core.text import short_repr
from depthcli.core.validation import Rule
from depthcli.errors import InputError


class CsvRow(NamedTuple):
    """A row of a table."""

    name: str  #: the table, for messages
    line: int  #: its last line, from 1
    cells: Mapping[str, str]  #: by column; "" where the row is too short

    def number(self, column: str, rule: Rule) -> float:
        """The number in a cell.

        Raises:
            InputError: it is no number, or out of range.
        """
        word = self.cells[column]
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not rule.holds(number):
            raise self.error(f"{column} is {rule.what}, not {short_repr(word)}")
        return number

    def error(self, problem: str) -> InputError:
        """The error to raise for a problem of this row."""
        return InputError(f"{self.name}, line {self.line}: {problem}")


class CsvTable:
    """A table in UTF-8; other bytes become surrogates, as in the names of files.

    Attributes:
        columns: names of its columns, without spaces around them; none if it is empty.
    """

    def __init__(self, data: bytes, name: str) -> None:
        """Read the first line.

        Raises:
            InputError: it is not CSV.
        """
        text = StringIO(data.decode("utf-8-sig", "surrogateescape"), newline="")
        self._name, self._lines = name, csv.reader(text, strict=True, skipinitialspace=True)
        self.columns = [word.strip() for word in next(self._cells(), [])]

    def __iter__(self) -> Iterator[CsvRow]:
        """The rows after the first line that are not empty, once.

        Raises:
            InputError: one is not CSV.
        """
        empty = dict.fromkeys(self.columns, "")
        for cells in filter(None, self._cells()):
            named = dict(zip(self.columns, map(str.strip, cells), strict=False))
            yield CsvRow(self._name, self._lines.line_num, empty | named)

    def _cells(self) -> Iterator[list[str]]:
        try:
            yield from self._lines
        except csv.Error as error:
            raise InputError(f"{self._name}, line {self._lines.line_num}: {error}") from error
