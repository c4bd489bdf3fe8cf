"""The files of known depth; free of numpy until they are read."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.options import DepthEncoding, Rule
from depthcli.errors import InputError, UsageError
from depthcli.io.formats.table import READABLE_SUFFIXES
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.paths import path_of, read_bytes, safe_name
from depthcli.io.tables import CsvTable

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from depthcli.core.arrays import Float64Array
    from depthcli.known.fit import AnchorPoints

_CLOUDS = (".pcd", ".ply")
#: suffixes of files with known depth
SUFFIXES = (".csv", *_CLOUDS, *(s for s in READABLE_SUFFIXES if s not in _CLOUDS))
SELF = "self"  #: in place of a path, the depth that a phone stored within each image
_COLMAP = ("cameras", "images", "points3D")
_OUTPUT = ".depth"  # end of the stems of the outputs of ``convert``
_ALTERNATIVES = f"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"


@dataclass(frozen=True)
class AnchorFiles:
    """A file with known depth, a folder of such files or of COLMAP's, or the images themselves."""

    path: str  #: the file, the folder, or ``SELF``
    #: units per metre; None for what the file states: of integers millimetres, else metres
    scale: float | None = None
    kind: DepthEncoding | None = None  #: of the numbers in a map that states none; None for metres
    camera: Intrinsics = UNKNOWN_CAMERA  #: of distances along the ray and of disparity, as stated
    baseline_m: float | None = None  #: between the two cameras of disparity
    extrinsics: Path | None = None  #: pose of the axes of clouds in the camera; None for its own

    @cached_property
    def reconstruction(self) -> tuple[Path, ...]:
        """The files of a reconstruction by COLMAP in the folder; none if there is none."""
        for suffix in () if self.path == SELF else (".bin", ".txt"):
            folder = path_of(self.path)
            files = tuple(folder / f"{part}{suffix}" for part in _COLMAP)
            if all(file.is_file() for file in files):
                return files
        return ()

    @property
    def is_by_image(self) -> bool:
        """Whether it is that of an image itself, or of its name."""
        return self.path == SELF or bool(self.reconstruction)

    @property
    def may_be_clouds(self) -> bool:
        """Whether it is a point cloud, or a folder that may have some."""
        suffix = path_of(self.path).suffix.lower()
        is_map = suffix in SUFFIXES and suffix not in (*_CLOUDS, ".bin")
        return not (self.is_by_image or is_map)

    def read(self, image: Path | None = None) -> AnchorPoints:
        """Depth of the file, or within the image or of its reconstruction; none without metres."""
        path = path_of(self.path)
        if not self.is_by_image and path.suffix.lower() not in SUFFIXES:
            raise InputError(f"{path} holds no known depth", f"give a file with {_ALTERNATIVES}")
        if not self.is_by_image:
            return read_known_depth(path, self)
        if image is None:
            raise InputError("standard input is no file whose own depth can be read")
        if self.reconstruction:
            from depthcli.known.clouds import read_reconstruction  # noqa: PLC0415 - needs numpy

            return read_reconstruction(self.reconstruction, image, self.scale)
        return _own_depth(image, self.camera)

    def file_for(
        self, name: str, *, shares_stem: bool = False, picture: Path | None = None
    ) -> Path:
        """The folder's file for a picture.

        For ``a.jpg``, that is ``a.jpg.npy``, else ``a.jpg.depth.npy``, ``a.npy`` or
        ``a.depth.npy``.

        With ``shares_stem``, ``a.npy`` could be that of another picture, such as ``a.png``. The
        picture's own file is not its known depth, whatever its suffix.
        """
        folder = path_of(self.path)
        above, slash, own = name.rpartition("/")
        base = above + slash + (own.rpartition(".")[0] or own)
        found = _files(folder, name) or _files(folder, name + _OUTPUT)
        if not found:
            found = _files(folder, base, picture) or _files(folder, base + _OUTPUT)
            if found and shares_stem:
                told = f"{found[0]} may be the known depth of this or another {safe_name(base)}"
                raise InputError(told, f"name it {safe_name(name)}{found[0].suffix}")
        if not found:
            raise InputError(
                f"{folder} has no known depth for it: {safe_name(base)} with {_ALTERNATIVES}"
            )
        if len(found) > 1:
            raise InputError(f"{found[0]} and {found[1]} are both its known depth", "remove one")
        return found[0]


def _files(folder: Path, stem: str, picture: Path | None = None) -> list[Path]:
    files = [file for suffix in SUFFIXES if (file := folder / (stem + suffix)).is_file()]
    return [file for file in files if picture is None or not is_same_file(file, picture)]


_PLACE_PX = Rule("a pixel from 0 at the top left", lambda px: abs(px) < 1e9)  # noqa: PLR2004
_DEPTH = Rule("a number", lambda _: True)  # those that are no depth are left out and counted
COLUMNS = {"x": _PLACE_PX, "y": _PLACE_PX, "depth_m": _DEPTH}  #: of a table


def read_known_depth(path: Path, stated: AnchorFiles) -> AnchorPoints:
    """The points of a CSV table, a cloud, or a sparse depth map of a stated scale and kind."""
    from depthcli.io.depth.read import read_stored_depth  # noqa: PLC0415
    from depthcli.io.formats.raster import COLMAP_MAP  # noqa: PLC0415
    from depthcli.io.stored.depth import DepthReadOptions  # noqa: PLC0415
    from depthcli.known.fit import AnchorPoints  # noqa: PLC0415 - needs numpy

    suffix = path.suffix.lower()
    if suffix == ".csv" and (stated.scale or stated.kind):
        raise InputError(
            f"{path} is in metres along the axis", "remove {anchors_scale} and {anchors_kind}"
        )
    if suffix in _CLOUDS or (suffix == ".bin" and not COLMAP_MAP.match(read_bytes(path))):
        return _of_cloud(path, stated)
    if suffix == ".csv":
        return AnchorPoints.of_table(numbers_of(CsvTable(read_bytes(path), str(path)), COLUMNS))
    options = DepthReadOptions(
        stated.scale, stated.kind, camera=stated.camera, baseline_m=stated.baseline_m
    )
    try:
        found = read_stored_depth(path, options)
    except UsageError as error:  # of this file, not of all that the scale is given for
        raise InputError(error.message, option="anchors_scale") from error
    depth = found.displayed
    if not depth.is_metric:
        raise InputError(f"{path} holds {depth.kind} depth, which has no metres")
    points = AnchorPoints.of_map(depth.values)
    if not len(points):
        raise InputError(f"{path} has no pixel with depth")
    return replace(points, warnings=found.warnings_with_scale("anchors_scale"))


def _of_cloud(path: Path, stated: AnchorFiles) -> AnchorPoints:
    from depthcli.known.clouds import projected, read_cloud  # noqa: PLC0415 - needs numpy
    from depthcli.known.extrinsics import read_extrinsics  # noqa: PLC0415

    if stated.kind:
        raise InputError(f"{path} has points in three dimensions", "remove {anchors_kind}")
    cloud_m, doubts = read_cloud(path) / (stated.scale or 1), tuple[str, ...]()
    if stated.extrinsics:
        pose, doubts = read_extrinsics(stated.extrinsics)
        cloud_m = cloud_m @ pose[:3, :3].T + pose[:3, 3]
    points = projected(cloud_m, stated.camera)
    points = replace(points, warnings=doubts + points.warnings)
    if not len(points):
        raise InputError(f"{path} has no point before the camera", "give its {extrinsics}")
    return points if stated.scale else points.doubted("{anchors_scale} states another")


def _own_depth(image: Path, camera: Intrinsics) -> AnchorPoints:
    from depthcli.io.depth.embedded import read_embedded_depth  # noqa: PLC0415
    from depthcli.io.stored.depth import DepthReadOptions  # noqa: PLC0415
    from depthcli.known.fit import AnchorPoints  # noqa: PLC0415 - needs numpy

    found = read_embedded_depth(image, DepthReadOptions(camera=camera))
    if found is None or not found.depth.is_metric:
        kind = "no depth" if found is None else "relative depth, which has no metres,"
        warning = f"{image} has {kind} of its own, so it is not fitted to any"
        return replace(AnchorPoints.of(()), warnings=(warning,))
    points = AnchorPoints.of_map(found.depth.values)
    if not len(points):
        raise InputError(f"{image} has no pixel with depth of its own")
    warnings = found.warnings or (f"{image}: its own depth is in metres",)
    return replace(points, warnings=warnings)


def numbers_of(table: CsvTable, columns: Mapping[str, Rule]) -> Float64Array:
    """The numbers in some columns, one or more rows: (N, columns) float64."""
    import numpy as np  # noqa: PLC0415

    for column in columns:
        if column not in table.columns:
            told = f"{table.name} has no column {column}"
            raise InputError(told, f"its first line has to name {', '.join(columns)}")
    rows = [[row.number(column, rule) for column, rule in columns.items()] for row in table]
    if not rows:
        raise InputError(f"{table.name} has no points")
    return np.array(rows, np.float64)
