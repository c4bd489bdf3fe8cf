"""Points in space as known depth: clouds and the poses of their sensors, reconstructions."""

import json
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from io import BytesIO, StringIO
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np

from depthcli.core.camera import DEPTH_M_RANGE, Intrinsics
from depthcli.core.options import INSTALL_POINTS
from depthcli.core.types import Float64Array
from depthcli.errors import InputError, Message
from depthcli.io.calibration import colmap_lines, documents_in, numbers_in
from depthcli.io.images import jpeg, tiff
from depthcli.io.images.pixels import upright_places
from depthcli.io.storage.paths import read_bytes
from depthcli.known.points import KnownDepth

_MAX_PX = 1e6  # columns and rows; points farther off the axis are in no image


def read_cloud(path: Path) -> Float64Array:
    """The points of a PLY, PCD or BIN: (N, 3) float64, as they are stored; NaN is no point."""
    data = read_bytes(path)
    try:
        if path.suffix.lower() == ".bin":  # x, y, z and intensity of KITTI; nuScenes has a ring
            columns = 5 if path.name.endswith(".pcd.bin") else 4
            return np.frombuffer(data, "<f4").reshape(-1, columns)[:, :3].astype(np.float64)
        if path.suffix.lower() == ".pcd":
            import pypcd4  # noqa: PLC0415 - an extra

            return _places(pypcd4.PointCloud.from_fileobj(BytesIO(data)))
        import trimesh  # noqa: PLC0415 - an extra

        cloud: Any = trimesh.load(BytesIO(data), file_type="ply", process=False)
        return np.asarray(cloud.vertices, np.float64).reshape(-1, 3)
    except ImportError as error:
        raise InputError(f"{path} needs {error.name}", f"install it: {INSTALL_POINTS}") from error
    except Exception as error:  # of the libraries, which raise of many types
        raise InputError(f"{path} is not a point cloud that can be read") from error


def cloud_of_message(message: Any) -> Float64Array:  # noqa: ANN401 - of the bag's types
    """The points of a ``PointCloud2`` in its frame: (N, 3) float64; NaN is no point."""
    import pypcd4  # noqa: PLC0415 - an extra

    return _places(pypcd4.PointCloud.from_msg(message))


def _places(scan: Any) -> Float64Array:  # noqa: ANN401 - of pypcd4
    return np.stack([scan.pc_data[axis] for axis in "xyz"], axis=-1).astype(np.float64)


def projected(cloud_m: Float64Array, camera: Intrinsics) -> KnownDepth:
    """Points (N, 3) of a camera's axes, x to the right, y down and z forward, in its image.

    Of several points in a pixel, the nearest counts. Points that are not finite, behind the camera
    or far outside of any image are left out and counted in a warning.
    """
    if camera.focal_px is None or camera.centre_px is None:
        problem = (
            "points in three dimensions need the focal length and the principal point in pixels"
        )
        raise InputError(problem, "give {calibration}, or {focal_px} and {centre_px}")
    depth_m = cloud_m[:, 2]
    lowest_m, highest_m = DEPTH_M_RANGE
    is_before = np.isfinite(cloud_m).all(axis=1) & (depth_m >= lowest_m) & (depth_m <= highest_m)
    across = cloud_m[is_before, :2] / cloud_m[is_before, 2:]
    focal_px = np.array([camera.focal_px, camera.focal_px * (camera.pixel_aspect or 1)])
    pixels = across * focal_px + np.array(camera.centre_px)
    is_near = (np.abs(pixels) < _MAX_PX).all(axis=1)
    pixels = np.rint(pixels[is_near]).astype(np.int64)
    depths_m = depth_m[is_before][is_near]
    nearest = np.argsort(depths_m, kind="stable")
    places = pixels @ [1, 4 * int(_MAX_PX)]
    _, first = np.unique(places[nearest], return_index=True)
    chosen = np.sort(nearest[first])
    x, y = pixels[chosen].T
    lost = len(cloud_m) - int(is_near.sum())
    problem = f"{lost} of {len(cloud_m)} points are behind the camera, far outside or not finite"
    warnings = (f"{problem}, and are not used",) if lost else ()
    return KnownDepth(x, y, depths_m[chosen], camera.size_px, warnings, may_be_outside=True)


class _Image(NamedTuple):
    """What a reconstruction knows of an image."""

    pose: tuple[float, ...]  #: quaternion w, x, y, z and translation, from the world to the camera
    camera: int
    #: (N, 3): column and row from the corner of the first pixel, and point; -1 for none
    sightings: Float64Array


def read_reconstruction(
    files: tuple[Path, ...], image: Path, units_per_m: float | None
) -> KnownDepth:
    """The points that were seen in an image, whose path ends in one that the files state.

    These are of cameras, images and points, binary or text; without ``units_per_m`` in their unit.
    """
    changed = tuple(file.stat().st_mtime_ns for file in files)
    sizes_px, images, points = _read(files, changed)
    folder = files[0].parent
    parts = PurePath(image).parts
    names = [n for n in images if parts[-len(PurePath(n).parts) :] == PurePath(n).parts]
    if not names:
        raise InputError(f"{folder} has no image {image.name}")
    view = images[max(names, key=len)]
    rows = [row for row in view.sightings.tolist() if int(row[2]) in points]
    places = np.array([points[int(row[2])] for row in rows]).reshape(-1, 3)
    depth = places @ rotation(*view.pose[:4])[2] + view.pose[6]
    depth_m = depth / (units_per_m or 1)
    is_before = (depth_m >= DEPTH_M_RANGE[0]) & (depth_m <= DEPTH_M_RANGE[1])
    if not is_before.any():
        raise InputError(f"{folder} has no points of {image.name}")
    pixels, size_px = _as_shown(np.array(rows)[is_before, :2], sizes_px[view.camera], image)
    x, y = np.floor(pixels).astype(np.int64).T  # from the corner
    unit = Message(
        f"depth is in the unit of {folder}, which is not known",
        "{anchors_scale} states how many of it are a metre",
    )
    lost = len(rows) - int(is_before.sum())
    behind = f"{lost} of {len(rows)} points are behind the camera and are not used"
    warnings = (unit,) * (units_per_m is None) + (behind,) * (lost > 0)
    return KnownDepth(x, y, depth_m[is_before], size_px, warnings)


def _as_shown(
    pixels: Float64Array, size_px: tuple[int, int], image: Path
) -> tuple[Float64Array, tuple[int, int]]:
    """Pixels of an image as COLMAP reads it, which ignores EXIF, in the upright one."""
    data = read_bytes(image)
    if not data.startswith(jpeg.JPEG_START):
        return pixels, size_px
    header, exif = jpeg.jpeg_header(data), tiff.parse_exif(jpeg.exif_of_jpeg(data))
    is_stored = (size_px[0] > size_px[1]) == (header.width > header.height)
    return upright_places(pixels, size_px, exif.orientation if is_stored else 1)


@lru_cache(maxsize=1)  # for all images of a batch
def _read(
    files: tuple[Path, ...], changed: tuple[int, ...]
) -> tuple[dict[int, tuple[int, int]], dict[str, _Image], dict[int, list[float]]]:
    """Columns and rows of the images of each camera, images by path, and points in the world."""
    del changed
    data = [read_bytes(file) for file in files]
    try:
        if files[0].suffix == ".bin":
            cameras, images, points = colmap_lines(data[0]), _images(data[1]), _points(data[2])
        else:
            texts = [part.decode() for part in data]
            cameras = [line.split() for line in _lines(texts[0]) if line.strip()]
            rows = np.loadtxt(StringIO(texts[2]), usecols=range(4), ndmin=2).tolist()
            images, points = _images_of_text(texts[1]), ((int(row[0]), row[1:]) for row in rows)
        sizes_px = {int(words[0]): (int(words[2]), int(words[3])) for words in cameras}
        return sizes_px, dict(images), dict(points)
    except (ValueError, IndexError, struct.error) as error:
        raise InputError(
            f"{files[0].parent} is not a reconstruction of COLMAP that can be read"
        ) from error


def _images(data: bytes) -> Iterator[tuple[str, _Image]]:
    at = 8
    for _ in range(*struct.unpack_from("<Q", data)):
        *pose, camera = struct.unpack_from("<7dI", data, at + 4)
        end = data.index(b"\0", at := at + 64)
        name = data[at:end].decode()
        (count,) = struct.unpack_from("<Q", data, end + 1)
        kinds = np.dtype([("pixel", "<2f8"), ("point", "<i8")])
        sightings = np.frombuffer(data, kinds, count, end + 9)
        at = end + 9 + count * kinds.itemsize
        yield (
            name,
            _Image(tuple(pose), camera, np.column_stack([sightings["pixel"], sightings["point"]])),
        )


def _points(data: bytes) -> Iterator[tuple[int, list[float]]]:
    at = 8
    for _ in range(*struct.unpack_from("<Q", data)):
        number, *place = struct.unpack_from("<Q3d", data, at)
        (views,) = struct.unpack_from("<Q", data, at + 43)  # after colour and error
        at += 51 + 8 * views
        yield number, place


def _lines(text: str) -> Iterator[str]:
    return (line for line in text.splitlines() if not line.startswith("#"))


def _images_of_text(text: str) -> Iterator[tuple[str, _Image]]:
    """Two lines an image, of which the second is empty if nothing was seen."""
    lines = _lines(text)
    for line in lines:
        if line.strip():
            _, *numbers, camera, name = line.split(maxsplit=9)
            sightings = np.array(next(lines, "").split(), np.float64).reshape(-1, 3)
            yield name.strip(), _Image(tuple(map(float, numbers)), int(camera), sightings)


_SIZE = 4  # rows and columns of a rotation and a translation in one matrix
_QUATERNION = 7  # numbers with a translation
_UNIT = 0.01  # by how much a length of 1 may be off, as that of numbers of three decimals
_ECHO = re.compile(r"Translation: (\[.*\])\s+- Rotation: in Quaternion.*(\[.*\])")  # of tf2_echo
_FLAT = ("x", "y", "z", "qx", "qy", "qz", "qw")
_CAMERA = re.compile(r"(?i)cam|rgb|colou?r|optical")
_SENSOR = re.compile(r"(?i)li?dar|velo|livox|laser|ouster|depth|world")
_WORD = f"(?:{_CAMERA.pattern[4:]}|{_SENSOR.pattern[4:]})"
# Names of what takes points of the first to the second, and of the second to the first.
_TO = re.compile(rf"(?i)({_WORD}[a-z0-9]*?)(?:_to_|to|2)({_WORD}[a-z0-9]*)")
_OF = re.compile(rf"(?i)(?:T_|(?=\w+_T_))({_WORD}[a-z0-9]*)_(?:T_)?({_WORD}[a-z0-9]*)")
_Frames = tuple[str, str]  # whose points are taken, and to which
_OWN = "sensor", "camera"  # of numbers that state none, as is documented
_UNDIRECTED = re.compile(r"transform(s|ation)?|pose|extrinsics?(_matrix)?")  # as is documented


class Extrinsics(NamedTuple):
    """The pose of a sensor in the camera."""

    matrix: Float64Array  #: (4, 4): takes points of the sensor to the camera
    warnings: tuple[str, ...] = ()  #: about frames that are stated


def read_extrinsics(path: Path) -> Extrinsics:
    """The pose in a text of 3×4 or 4×4 numbers by rows, or of x y z qx qy qz qw; or of a program.

    These are KITTI's calibration of objects or odometry, for camera 2 as of
    :func:`depthcli.io.calibration.read_calibration`; a transform of ROS, whose frames count; and
    YAML or JSON with one matrix or pose whose name states its direction, such as
    ``T_lidar_camera`` or ``lidar_to_camera``.

    Raises:
        InputError: there is no such pose, or several.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
        poses = _poses(_tree(text), _frames_of(path.stem) or _OWN)
        (only,) = {pose.matrix.tobytes(): pose for pose in poses}.values()
    except InputError:
        raise
    except Exception as error:  # of the libraries, and of numbers in odd places
        problem = f"{path} is not the pose of a sensor in the camera"
        advice = "give 3×4 numbers, rotation and metres, x y z qx qy qz qw, or a matrix T_cam_lidar"
        raise InputError(problem, advice) from error
    return only


def _tree(text: str) -> Any:  # noqa: ANN401 - of any file
    """Numbers, or what a file names."""
    if echoed := _ECHO.findall(text):
        return [[*json.loads(place), *json.loads(turn)] for place, turn in echoed]
    plain = re.sub(r"[\[\],;]", " ", text).split()
    try:
        return [float(word) for word in plain]
    except ValueError:
        return list(documents_in(text))


def _poses(tree: Any, frames: _Frames | None) -> Iterator[Extrinsics]:  # noqa: ANN401
    """The poses of a tree, by what states their frames; None is of numbers of unknown meaning."""
    if isinstance(tree, Mapping) and "data" not in tree:
        yield from _named_poses(tree, frames)
        return
    is_nested = isinstance(tree, list) and any(isinstance(part, Mapping) for part in tree)
    numbers = [] if is_nested else numbers_in(tree)
    if len(numbers) in {_QUATERNION, 3 * _SIZE, _SIZE**2} and np.isfinite(numbers).all():
        if frames is not None:
            yield _directed(matrix_of(numbers), frames)
    elif isinstance(tree, list):
        for part in tree:
            yield from _poses(part, frames)


def _named_poses(tree: Mapping[str, Any], frames: _Frames | None) -> Iterator[Extrinsics]:
    if "Tr" in tree or "Tr_velo_to_cam" in tree:
        yield Extrinsics(_of_kitti(tree))
        return
    if "Rcl" in tree and "Pcl" in tree:  # of FAST-LIVO2
        turn = np.reshape(numbers_in(tree["Rcl"]), (3, 3))
        matrix = matrix_of(np.column_stack([turn, numbers_in(tree["Pcl"])]).ravel().tolist())
        yield _directed(matrix, _OWN)
        return
    if child := tree.get("child_frame_id"):
        frames = str(child), str(tree.get("header", tree).get("frame_id"))
    flat, place = tree, tree.get("translation", tree.get("position"))
    turn = tree.get("rotation", tree.get("orientation"))
    if isinstance(place, Mapping) and isinstance(turn, Mapping):
        flat = {**place, **{f"q{axis}": number for axis, number in turn.items()}}
    if frames is not None and all(name in flat for name in _FLAT):
        yield _directed(matrix_of([float(flat[name]) for name in _FLAT]), frames)
        return
    for name, value in tree.items():
        unnamed = frames if _UNDIRECTED.fullmatch(name) else None
        yield from _poses(value, _frames_of(name) or unnamed)


def _frames_of(name: str) -> _Frames | None:
    """The frames that the name of a pose states, if one is that of a camera."""
    if name == "CameraExtrinsicMat":  # of Autoware, by its definition
        return "camera", "lidar"
    to, of = _TO.search(name), _OF.match(name)
    frames = (to[1], to[2]) if to else (of[2], of[1]) if of else ("", "")
    return frames if sum(map(_is_camera, frames)) == 1 else None


def _is_camera(frame: str) -> bool:
    return bool(_CAMERA.search(frame) and not _SENSOR.search(frame))


def _directed(matrix: Float64Array, frames: _Frames) -> Extrinsics:
    """A pose that takes points of the first frame to the second, as one to the camera."""
    turn, (source, target) = matrix[:3, :3], frames
    is_pose = np.allclose(turn @ turn.T, np.eye(3), atol=_UNIT) and np.linalg.det(turn) > 0
    if not is_pose or _is_camera(source) == _is_camera(target):
        raise ValueError(frames)
    camera = target if _is_camera(target) else source
    if camera.endswith(("_link", "_frame")) and "optical" not in camera:  # x forward by REP 103
        raise InputError(f"{camera} has no axes of images", "give the pose in its optical frame")
    if camera is target:
        return Extrinsics(matrix)
    warning = f"the extrinsics take points of {source} to {target}, so their inverse is used"
    return Extrinsics(np.asarray(np.linalg.inv(matrix), np.float64), (warning,))


def matrix_of(numbers: Sequence[float]) -> Float64Array:
    """3×4 or 4×4 numbers, or a translation and a quaternion, as (4, 4)."""
    values = np.array(numbers)
    if len(values) == _QUATERNION:
        turn = values[3:] / np.linalg.norm(values[3:])
        if not np.allclose(turn, values[3:], atol=_UNIT):
            raise ValueError(numbers)
        x, y, z, w = turn
        values = np.column_stack([rotation(w, x, y, z), values[:3]]).ravel()
    rows = values.reshape(-1, _SIZE)
    if len(rows) == _SIZE and rows[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(numbers)
    return np.concatenate([rows[:3], np.eye(_SIZE)[3:]])


def rotation(w: float, x: float, y: float, z: float) -> Float64Array:
    """The matrix of a quaternion of length 1: (3, 3)."""
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def _of_kitti(tree: Mapping[str, Any]) -> Float64Array:
    """From the lidar to the camera of reference, rectified, and to camera 2 beside it."""
    rectified, beside = np.eye(_SIZE), np.eye(_SIZE)
    if "R0_rect" in tree:
        rectified[:3, :3] = np.reshape(numbers_in(tree["R0_rect"]), (3, 3))
    if "P2" in tree:
        projection = matrix_of(numbers_in(tree["P2"]))
        beside[0, 3] = projection[0, 3] / projection[0, 0]
    lidar = _directed(matrix_of(numbers_in(tree.get("Tr_velo_to_cam", tree.get("Tr")))), _OWN)
    return np.asarray(beside @ rectified @ lidar.matrix)
