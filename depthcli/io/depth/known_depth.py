"""Reading known depth: tables of points, and sparse depth maps."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import DEPTH_M
from depthcli.core.validation import Rule
from depthcli.errors import InputError, UsageError
from depthcli.io.csv_table import CsvTable
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.images.decode import read_bytes

_WITHOUT_SCALE = (".csv", ".exr")
_PLACE_PX = Rule("a pixel from 0 at the top left", lambda px: -0.5 <= px < 1e9)  # noqa: PLR2004
_COLUMNS = {"x": _PLACE_PX, "y": _PLACE_PX, "depth_m": DEPTH_M}


def read_known_depth(path: Path, scale: float | None) -> AnchorPoints:
    """The points of a CSV table, or of a sparse depth map in PNG, EXR or NPY.

    Args:
        path: the file.
        scale: units per metre of PNG and of integers in NPY; None for what the file states, or
            millimetres.

    Raises:
        InputError: it cannot be read, or holds no known depth, or there is a scale and its format
            has none.
    """
    suffix = path.suffix.lower()
    if scale is not None and suffix in _WITHOUT_SCALE:
        raise InputError(f"{path} is in metres; --anchors-scale is for PNG and NPY")
    if suffix == ".csv":
        return _table(read_bytes(path), str(path))
    try:
        stored = read_stored_depth(path, png_scale=scale)
    except UsageError as error:  # of this file, not of all that the scale is given for
        raise InputError(f"--anchors-scale: {error}") from error
    depth = stored.displayed
    if not depth.is_metric:
        raise InputError(f"{path} holds {depth.kind} depth, which has no metres")
    points = AnchorPoints.of_map(depth.values)
    if not len(points):
        raise InputError(f"{path} has no pixel with depth")
    return replace(points, warnings=stored.warnings_with_scale("--anchors-scale"))


def _table(data: bytes, name: str) -> AnchorPoints:
    """The points of a CSV table with the columns x, y and depth_m."""
    table = CsvTable(data, name)
    for column in _COLUMNS:
        if column not in table.columns:
            raise InputError(
                f"{name} has no column {column}; its first line has to name x, y and depth_m"
            )
    points = [[row.number(column, rule) for column, rule in _COLUMNS.items()] for row in table]
    if not points:
        raise InputError(f"{name} has no points")
    return AnchorPoints.of_table(np.array(points, np.float64))
