"""Reading known depth: tables of points, and sparse depth maps."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera_ranges import DEPTH_M
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.pictures.decode import read_bytes

_WITHOUT_SCALE = (".csv", ".exr")
_MOST_PX = 1e9
_COLUMNS = ("x", "y", "depth_m")


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
    try:
        text = io.StringIO(data.decode("utf-8-sig"), newline="")
        rows = csv.DictReader(text, strict=True, skipinitialspace=True)
        rows.fieldnames = [name.strip() for name in rows.fieldnames or ()]
        missing = [column for column in _COLUMNS if column not in rows.fieldnames]
        if missing:
            raise InputError(
                f"{name} has no column {missing[0]}; its first line has to name x, y and depth_m"
            )
        points = []
        for row in rows:
            points.append(_point(row))
            if points[-1] is None:
                raise InputError(
                    f"{name}, line {rows.line_num}: give x and y in pixels from 0 at the top left, "
                    f"and depth_m, {DEPTH_M.what}"
                )
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{name} is not a CSV table in UTF-8: {error}") from error
    if not points:
        raise InputError(f"{name} has no points")
    return AnchorPoints.of_table(np.array(points, np.float64))


def _point(row: dict[str, str | None]) -> tuple[float, float, float] | None:
    try:
        x, y, depth_m = (float(row[column] or "") for column in _COLUMNS)
    except ValueError:
        return None
    is_pixel = -0.5 <= x < _MOST_PX and -0.5 <= y < _MOST_PX  # noqa: PLR2004 - the first one's edge
    return (x, y, depth_m) if is_pixel and DEPTH_M.holds(depth_m) else None
