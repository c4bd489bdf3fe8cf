"""The cameras of a table, matched with the inputs of a batch."""

import os
from collections.abc import Iterator, Mapping

from depthcli.core.camera import Intrinsics
from depthcli.core.text import short_repr
from depthcli.errors import InputError, UsageError
from depthcli.io.lens_table import read_lenses
from depthcli.io.storage.remote import path_of
from depthcli.jobs.namesakes import stem


class CameraTable:
    """Finds the camera of each input, and notes which rows match.

    A row's id is the name of an input (``hall/a.jpg``), or the name without suffix (``hall/a``), as
    in the ``cameras.csv`` of training folders. The whole name is looked up first.
    """

    def __init__(self, lenses: Mapping[str, Intrinsics], source: str = "the table") -> None:
        """Begin with no input.

        Args:
            lenses: camera of each id.
            source: name of the table in messages.
        """
        self._lenses, self._source = lenses, source
        self._used: dict[str, str] = {}  # id -> the input that it matches

    def lens(self, name: str) -> Intrinsics | None:
        """The camera of an input; None if it has no row, or an empty one.

        Raises:
            UsageError: its row is also that of another input.
        """
        row_id = next((key for key in (name, stem(name)) if key in self._lenses), None)
        if row_id is None:
            return None
        other = self._used.setdefault(row_id, name)
        if other != name:
            raise UsageError(
                f"{self._source}: the row {short_repr(row_id)} is of {other} and of {name}; give "
                "each a row with its suffix"
            )
        return self._lenses[row_id]

    def warnings(self, inputs: int, unmatched: int) -> Iterator[str]:
        """What did not match, one line each.

        Args:
            inputs: number of inputs of the batch.
            unmatched: how many of them have no row, or an empty one.

        Raises:
            UsageError: there are inputs, and no row matches one.
        """
        unused = [row_id for row_id in self._lenses if row_id not in self._used]
        if unused and inputs and not self._used:
            raise UsageError(
                f"no row of {self._source} with a camera matches an input; an id is the path of an "
                "input from the folder, with or without its suffix, but the first is "
                f"{short_repr(unused[0])}"
            )
        if unmatched:
            yield (
                f"{self._source} has no camera for {unmatched} of {inputs} inputs; their focal "
                "lengths are those in EXIF, or assumed"
            )
        if unused:
            yield (
                f"{len(unused)} of {len(self._lenses)} rows of {self._source} match no input, for "
                f"example {short_repr(unused[0])}"
            )


def read_cameras(source: str) -> CameraTable:
    """The table in a CSV file, which may be a URI.

    Raises:
        UsageError: it cannot be read, or has invalid rows.
    """
    try:
        return CameraTable(read_lenses(path_of(source)), os.fspath(source))
    except InputError as error:
        raise UsageError(f"--cameras: {error}") from error
