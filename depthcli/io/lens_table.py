"""The camera of each picture in a CSV table, such as ``cameras.csv`` of a training folder."""

from pathlib import Path

from depthcli.core.camera import CENTRE_PX, FOCAL_PX, HFOV_DEG, UNKNOWN_CAMERA, Intrinsics
from depthcli.core.text import short_repr
from depthcli.errors import InputError
from depthcli.io.csv_table import CsvRow, CsvTable
from depthcli.io.storage.regular import read_regular

ID = "id"
_FOCAL = frozenset({"focal_px", "hfov_deg"})
_RULES = {"focal_px": FOCAL_PX, "hfov_deg": HFOV_DEG, "cx": CENTRE_PX, "cy": CENTRE_PX}
_MAX_BYTES = 256 * 2**20


def read_lenses(path: Path) -> dict[str, Intrinsics]:
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
        data = read_regular(path, _MAX_BYTES)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    table = CsvTable(data, str(path))
    if ID not in table.columns or _FOCAL.isdisjoint(table.columns):
        raise InputError(f"{path} has no columns id,focal_px or id,hfov_deg in its first line")
    found: dict[str, Intrinsics] = {}
    for row in table:
        _add(found, row)
    return found


def _add(found: dict[str, Intrinsics], row: CsvRow) -> None:
    focal_px, hfov_deg, cx, cy = (
        row.number(column, rule) if row.cells.get(column) else None
        for column, rule in _RULES.items()
    )
    if (cx is None) != (cy is None):
        raise row.error("give cx and cy, or neither")
    centre_px = None if cx is None or cy is None else (cx, cy)
    lens = Intrinsics(focal_px, None if focal_px is not None else hfov_deg, centre_px)
    if lens == UNKNOWN_CAMERA:
        return
    name = row.cells[ID].removeprefix("./")
    if not name:
        raise row.error("the id is missing")
    if found.setdefault(name, lens) != lens:
        raise row.error(f"another row of {short_repr(name)} has another camera")
