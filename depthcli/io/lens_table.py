"""The camera of each picture in a CSV table, such as ``cameras.csv`` of a training folder."""

import csv
import math
from io import StringIO
from pathlib import Path

from depthcli.core.camera import Lens
from depthcli.core.camera_ranges import CENTRE_PX, FOCAL_PX, HFOV_DEG
from depthcli.core.text import short_repr
from depthcli.errors import InputError
from depthcli.io.storage.regular import read_regular

ID = "id"
_FOCAL = frozenset({"focal_px", "hfov_deg"})
_RULES = {"focal_px": FOCAL_PX, "hfov_deg": HFOV_DEG, "cx": CENTRE_PX, "cy": CENTRE_PX}
_MAX_BYTES = 256 * 2**20


def read_lenses(path: Path) -> dict[str, Lens]:
    """The camera of each id.

    The first line names the columns: ``id``, and ``focal_px`` (pixels of the picture), ``hfov_deg``
    (horizontal field of view in degrees) or both. In a row with both, ``focal_px`` counts. ``cx``
    and ``cy``, the principal point in pixels of the picture, are optional. A row without any of
    these is left out. Other columns are ignored.

    Raises:
        InputError: it cannot be read, lacks a column, has an invalid number, or two different rows
            of one id.
    """
    try:
        text = read_regular(path, _MAX_BYTES).decode("utf-8-sig", "surrogateescape")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    rows = csv.DictReader(StringIO(text, newline=""), skipinitialspace=True)
    try:
        columns = rows.fieldnames = [name.strip() for name in rows.fieldnames or ()]
        if ID not in columns or _FOCAL.isdisjoint(columns):
            raise InputError(f"{path} has no columns id,focal_px or id,hfov_deg in its first line")
        found: dict[str, Lens] = {}
        for row in rows:
            _add(found, row)
    except (ValueError, csv.Error) as error:
        raise InputError(f"{path}, line {rows.reader.line_num}: {error}") from error
    return found


def _add(found: dict[str, Lens], row: dict[str, str | None]) -> None:
    """Add a row.

    Raises:
        ValueError: it cannot be used.
    """
    focal_px, hfov_deg, cx, cy = (_number(name, row.get(name) or "") for name in _RULES)
    if (cx is None) != (cy is None):
        raise ValueError("give cx and cy, or neither")
    centre_px = None if cx is None or cy is None else (cx, cy)
    lens = Lens(focal_px, None if focal_px is not None else hfov_deg, centre_px)
    if lens == Lens():
        return
    name = (row[ID] or "").strip().removeprefix("./")
    if not name:
        raise ValueError("the id is missing")
    if found.setdefault(name, lens) != lens:
        raise ValueError(f"another row of {short_repr(name)} has another camera")


def _number(column: str, word: str) -> float | None:
    """The number in a cell; None if it is empty.

    Raises:
        ValueError: it is no number, or out of range.
    """
    if not word.strip():
        return None
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not _RULES[column].holds(number):
        raise ValueError(f"{column} is {_RULES[column].what}, not {short_repr(word)}")
    return number
