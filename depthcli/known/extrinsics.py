"""Poses of sensors in the camera, as programs of calibration and ROS write them."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from depthcli.core.arrays import Float64Array
from depthcli.errors import InputError
from depthcli.io.calibration import documents_in, numbers_in
from depthcli.io.storage.paths import read_bytes

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
    is_pose &= bool(np.isfinite(matrix).all())
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
