"""Reading known depth: tables, clouds, reconstructions, sparse maps, phones, topics of bags.

That of the frames of a video is the same for all, or of each by its number or time.
"""

import re
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from depthcli.core.camera import Anchor, Intrinsics
from depthcli.core.options import DepthFit, Rule
from depthcli.core.types import Float64Array
from depthcli.errors import InputError, UsageError
from depthcli.io.bags import CLOUD, Origin, Transforms, pixels_of
from depthcli.io.depth.read import read_embedded_depth, read_stored_depth
from depthcli.io.formats.raster import COLMAP_MAP
from depthcli.io.listing import CsvTable
from depthcli.io.storage.paths import path_of, read_bytes
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.known import clouds
from depthcli.known.files import ALTERNATIVES, CLOUDS, OUTPUT, SUFFIXES, KnownDepthFiles
from depthcli.known.points import KnownDepth
from depthcli.video.numbering import times_ns

_PLACE_PX = Rule("a pixel from 0 at the top left", lambda px: abs(px) < 1e9)  # noqa: PLR2004
_DEPTH = Rule("a number", lambda _: True)  # those that are no depth are left out and counted
_ENCODINGS = {"16UC1": ("u2", 1000), "mono16": ("u2", 1000), "32FC1": ("f4", 1)}  # REP 118
COLUMNS = {"x": _PLACE_PX, "y": _PLACE_PX, "depth_m": _DEPTH}  #: of a table


def read_known_depth(
    files: KnownDepthFiles | tuple[Anchor, ...], image: Path | None = None
) -> KnownDepth:
    """Depth of points, a file, an image itself or its reconstruction; none without metres."""
    if isinstance(files, tuple):
        return KnownDepth.of(files)
    path = path_of(files.path)
    if not files.is_by_image and path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path} holds no known depth", f"give a file with {ALTERNATIVES}")
    if not files.is_by_image:
        return read_file(path, files)
    if files.topic:
        raise InputError(f"{image or 'standard input'} is in no bag, whose topics have known depth")
    if image is None:
        raise InputError("standard input is no file whose own depth can be read")
    if files.reconstruction:
        return clouds.read_reconstruction(files.reconstruction, image, files.scale)
    return _of_phone(image, files.camera)


def read_file(path: Path, files: KnownDepthFiles) -> KnownDepth:
    """The points of a CSV table, a cloud, or a sparse depth map of a stated scale and kind."""
    suffix = path.suffix.lower()
    if suffix == ".csv" and (files.scale or files.kind):
        raise InputError(
            f"{path} is in metres along the axis", "remove {anchors_scale} and {anchors_kind}"
        )
    if suffix in CLOUDS or (suffix == ".bin" and not COLMAP_MAP.match(read_bytes(path))):
        return _of_cloud(path, files)
    if suffix == ".csv":
        return KnownDepth.of_table(numbers_of(CsvTable(read_bytes(path), str(path)), COLUMNS))
    options = DepthReadOptions(
        files.scale, files.kind, camera=files.camera, baseline_m=files.baseline_m
    )
    try:
        stored = read_stored_depth(path, options)
    except UsageError as error:  # of this file, not of all that the scale is given for
        raise InputError(error.message, option="anchors_scale") from error
    depth = stored.displayed
    if not depth.is_metric:
        raise InputError(f"{path} holds {depth.kind} depth, which has no metres")
    points = KnownDepth.of_map(depth.values)
    if not len(points):
        raise InputError(f"{path} has no pixel with depth")
    may_be_stored = depth.provenance.orientation is None
    warnings = stored.warnings_with_scale("anchors_scale")
    return replace(points, warnings=warnings, may_be_stored=may_be_stored)


def _of_cloud(path: Path, files: KnownDepthFiles) -> KnownDepth:
    if files.kind:
        raise InputError(f"{path} has points in three dimensions", "remove {anchors_kind}")
    points = _placed(clouds.read_cloud(path), files)
    if not len(points):
        raise InputError(f"{path} has no point before the camera", "give its {extrinsics}")
    return points if files.scale else points.doubted("{anchors_scale} states another")


def _placed(
    cloud: Float64Array, files: KnownDepthFiles, pose: Float64Array | None = None
) -> KnownDepth:
    """The points of a cloud in the image; the pose is in place of that of extrinsics."""
    cloud_m, doubts = cloud / (files.scale or 1), tuple[str, ...]()
    if files.extrinsics:
        pose, doubts = clouds.read_extrinsics(files.extrinsics)
    if pose is not None:
        cloud_m = cloud_m @ pose[:3, :3].T + pose[:3, 3]
    points = clouds.projected(cloud_m, files.camera)
    return replace(points, warnings=doubts + points.warnings)


def _of_phone(image: Path, camera: Intrinsics) -> KnownDepth:
    stored = read_embedded_depth(image, DepthReadOptions(camera=camera))
    if stored is None or not stored.depth.is_metric:
        kind = "no depth" if stored is None else "relative depth, which has no metres,"
        warning = f"{image} has {kind} of its own, so it is not fitted to any"
        return replace(KnownDepth.of(()), warnings=(warning,))
    points = KnownDepth.of_map(stored.depth.values)
    if not len(points):
        raise InputError(f"{image} has no pixel with depth of its own")
    warnings = stored.warnings or (f"{image}: its own depth is in metres",)
    return replace(points, warnings=warnings)


def numbers_of(table: CsvTable, columns: Mapping[str, Rule]) -> Float64Array:
    """The numbers in some columns, one or more rows: (N, columns) float64."""
    for column in columns:
        if column not in table.columns:
            problem = f"{table.name} has no column {column}"
            raise InputError(problem, f"its first line has to name {', '.join(columns)}")
    rows = [[row.number(column, rule) for column, rule in columns.items()] for row in table]
    if not rows:
        raise InputError(f"{table.name} has no points")
    return np.array(rows, np.float64)


def read_topic(origin: Origin, files: KnownDepthFiles, camera: Intrinsics) -> KnownDepth:
    """The known depth of an image of a bag; none, with a warning, if no message is near.

    A cloud is taken to the image by ``/tf_static``, or by the extrinsics of the files.

    Raises:
        InputError: the message holds no depth, or its place in the image is not known.
    """
    message = origin.sensor
    if message is None:
        warning = f"no message of {files.topic} within 0.1 s, so depth is not fitted to it"
        return replace(KnownDepth.of(()), warnings=(warning,))
    frame, image_frame = message.header.frame_id, origin.header.frame_id
    if message.__msgtype__ == CLOUD:
        pose = None if files.extrinsics else _pose(origin.transforms, frame, image_frame)
        points = _placed(clouds.cloud_of_message(message), replace(files, camera=camera), pose)
    elif frame == image_frame:
        points = KnownDepth.of_map(_depth(message))
    else:
        problem = f"depth of {files.topic} is of the frame {frame}, and the image of {image_frame}"
        raise InputError(problem, "choose a topic with depth that is aligned to the images")
    if not len(points):
        raise InputError(f"{files.topic} has no point in the image")
    return points


def _depth(message: Any) -> Float64Array:  # noqa: ANN401
    """Metres of a depth image: (H, W) float64; 0 and NaN are unknown."""
    if message.encoding not in _ENCODINGS:
        raise InputError(f"images of encoding {message.encoding} hold no depth")
    kind, units = _ENCODINGS[message.encoding]
    return np.asarray(pixels_of(message, kind)[..., 0] / units)


def _pose(transforms: Transforms, source: str, target: str) -> Float64Array:
    """What takes points of one frame to another: (4, 4)."""
    of_source, of_target = _above(transforms, source), _above(transforms, target)
    shared = next((frame for frame in of_source if frame in of_target), None)
    if shared is None:
        problem = f"/tf_static does not connect the frames {source} and {target}"
        raise InputError(problem, "give {extrinsics}")
    return np.asarray(np.linalg.inv(of_target[shared]) @ of_source[shared])


def _above(transforms: Transforms, frame: str) -> dict[str, Float64Array]:
    """A frame and those above, with what takes its points to each."""
    poses: dict[str, Float64Array] = {frame: np.eye(4)}
    while frame in transforms and transforms[frame][0] not in poses:
        above, numbers = transforms[frame]
        poses[above] = clouds.matrix_of(numbers) @ poses[frame]
        frame = above
    return poses


_LAST_NUMBER = re.compile(r"(\d+)\D*$", re.ASCII)
_FRAME, _TIME_S = "frame", "time_s"
_RULES = {
    _FRAME: Rule("the number of a frame", lambda n: 0 <= n < 1e12 and n == int(n)),  # noqa: PLR2004
    _TIME_S: Rule("seconds from the first frame", lambda s: abs(s) < 1e9),  # noqa: PLR2004
}


class KnownDepthOfFrames:
    """Known depth of each frame of a video; thread-safe.

    A folder has a file for each frame, whose name ends in the number of the frame. A table has a
    column ``frame`` or ``time_s``, or is of all frames, as any other file and a list of points.

    Attributes:
        paths: its files, and that of extrinsics.
    """

    def __init__(
        self,
        source: KnownDepthFiles | tuple[Anchor, ...],
        fit: DepthFit | None = None,
        within_s: float | None = None,
    ) -> None:
        """List the folder, or read the file; there may be neither.

        ``within_s`` is the largest distance from a frame in seconds; None for half a frame.
        """
        self._source, self._fit, self._within_s = source, fit, within_s
        self.paths = list[Path]()
        self._of_all: KnownDepth | None = None
        self._each: Mapping[float, KnownDepth | Path] = {}
        self._is_timed = False
        self._read = lru_cache(maxsize=2)(read_file)
        self._reading = defaultdict[Path, Lock](Lock)
        if isinstance(source, tuple):
            self._of_all = KnownDepth.of(source) if source else None
            return
        path = path_of(source.path)
        self.paths = [path]
        if path.is_dir():
            files = _numbered_files(path)
            self._each, self.paths = dict(sorted(files.items())), [*files.values()]
        elif path.suffix.lower() == ".csv":
            self._read_table(path, source)
        else:
            self._of_all = read_known_depth(source)
        if source.extrinsics:
            self.paths.append(source.extrinsics)

    def of_frame(
        self, number: int, time_s: float, rate: float, numbers_a_second: float | None = None
    ) -> KnownDepth | None:
        """The points of a frame of a video of ``rate`` frames a second; None if it has none.

        ``numbers_a_second`` is of images that are numbered by their times.
        """
        points: KnownDepth | Path | None = self._of_all
        if self._each:
            keys, at = list(self._each), time_s if self._is_timed else number
            after = bisect_left(keys, at)
            nearest = min(keys[max(0, after - 1) : after + 1], key=lambda key: abs(key - at))
            within_s = 0.5 / rate if self._within_s is None else self._within_s
            within = within_s if self._is_timed else within_s * (numbers_a_second or rate)
            points = self._each[nearest] if abs(nearest - at) <= within else None
        if isinstance(points, Path) and isinstance(self._source, KnownDepthFiles):
            with self._reading[points]:  # once for all frames near a scan
                points = self._read(points, self._source)
        return replace(points, fit=self._fit) if isinstance(points, KnownDepth) else None

    def states(self) -> list[object]:
        """What the depth of the frames depends on, for a fingerprint."""
        files = [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in self.paths]
        return [self._source, self._fit, self._within_s, files]

    def _read_table(self, path: Path, files: KnownDepthFiles) -> None:
        table = CsvTable(read_bytes(path), str(path))
        key = next((name for name in _RULES if name in table.columns), None)
        if key is None:
            self._of_all = read_file(path, files)
            return
        rows = numbers_of(table, {key: _RULES[key], **COLUMNS})
        self._is_timed = key == _TIME_S
        self._each = {
            float(at): KnownDepth.of_table(rows[rows[:, 0] == at, 1:])
            for at in np.unique(rows[:, 0])
        }


def _numbered_files(folder: Path) -> dict[int, Path]:
    """The files of known depth in a folder by the last number in their names."""
    listed = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    names = {path: path.stem.removesuffix(OUTPUT) for path in listed}
    last = {path: match for path, name in names.items() if (match := _LAST_NUMBER.search(name))}
    numbers = times_ns([names[path] for path in last]) or [int(match[1]) for match in last.values()]
    files: dict[int, Path] = {}
    for path, at in zip(last, numbers, strict=True):
        if at in files:
            raise InputError(f"{files[at]} and {path} are both of frame {at}", "remove one")
        files[at] = path
    if not files:
        advice = f"name its files by numbers, such as 000012{SUFFIXES[0]} for frame 12"
        raise InputError(f"{folder} has no known depth of any frame", advice)
    return files
