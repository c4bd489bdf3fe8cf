"""Cameras: calibrations of other programs, a table of one row an image, and those kept by name."""

import json
import math
import os
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree as ET

from depthcli.core.camera import (
    CENTRE_PX,
    FOCAL_PX,
    HFOV_DEG,
    UNKNOWN_CAMERA,
    CameraScale,
    Distortion,
    Intrinsics,
    hfov_deg,
)
from depthcli.core.options import Rule, short_repr
from depthcli.core.validation import parsed_json, validated
from depthcli.errors import InputError, OutputError, UsageError, os_errors_as
from depthcli.io.listing import CsvTable
from depthcli.io.storage import atomic, paths

_ADVICE = "name the calibration of a camera"
_SIZES = (("image_width", "image_height"), ("width", "height"), ("w", "h"), ("W", "H"))
_MATRICES = ("camera_matrix", "K", "k", "CameraMat")
_PROJECTIONS = ("projection_matrix", "P", "p")
_DISTORTIONS = re.compile(r"(?i:dist(?!ance))\w*|coeffs|[Dd]|d\d")  # nodes with coefficients
_COEFFICIENTS = re.compile(r"[kp]\d")
_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # of OpenCV
_FISHEYE_ORDER = ("k1", "k2", "k3", "k4")
_MODELS = ("distortion_model", "camera_model", "type", "model_type", "model")
_FISHEYE = re.compile(r"equidistant|fisheye|kannala")
_OTHER_MODELS = re.compile(r"fov|division|thin_prism|omni|(inverse|modified)_brown|another")
_LISTS = ("intrinsics", "intrinsic", "calibration")  # nodes with fx, fy, cx, cy and distortion
_GROUPS = ("camera", "cam", "camera_params")  # of Replica, NICE-SLAM and SplaTAM
_NORMALIZED = 10  # MoGe, DUSt3R and RealEstate10K state intrinsics in shares of the size
_COLMAP_LINE = re.compile(r"\d+\s+[A-Z_]{3,}\s+\d+\s+\d+(\s+\S+)+")
# Models of COLMAP's src/colmap/sensor/models.h by id; those with one focal length; a count.
_COLMAP_MODELS = (
    *(("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8)),
    *(("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4)),
    *(("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12)),
)
_ONE_FOCAL = re.compile(r"SIMPLE_|RADIAL")
_MAX_BYTES = 2**20
_MAX_PX = 1e6
_CORNER = 0.5  # of nerfstudio and COLMAP, which count from the corner of the first pixel
_SQUARE = 0.001  # largest difference of fx and fy of square pixels, as a share


@dataclass(frozen=True, slots=True)
class _Camera:
    """Numbers of a calibration, not checked yet."""

    matrix: tuple[float, float, float, float]  #: fx, fy, cx, cy; (0, 0) is the first pixel's middle
    size_px: tuple[float, float] | None = None  #: columns, rows; None if they are not stated
    coefficients: tuple[float, ...] = ()  #: of distortion, in the order of its model
    model: str = ""  #: of distortion, in lower case; empty if it is not stated


def read_calibration(path: str | os.PathLike[str], *, rectified: bool = False) -> Intrinsics:
    """A calibration of a camera, in one of many formats that is recognized by its content.

    These are ``camera_info`` YAML of ROS, as its tools or ``ros2 topic echo`` write it; YAML, XML
    and JSON of OpenCV; YAML of Kalibr, ORB-SLAM and VINS; ``cameras.txt`` and ``cameras.bin`` of
    COLMAP; ``transforms.json`` of nerfstudio; JSON of Open3D; text of KITTI; YAML of Autoware and
    FAST-LIVO2; and a text file with a 3×3 or 4×4 matrix.

    Of a ``CameraInfo`` with a region of interest, it is the camera of the images of that region.
    Its focal length is the geometric mean of fx and fy, or fx if they differ by over .1 %. Its
    ``hfov_deg`` is for ``predict``, its ``pixel_aspect`` for a ``Frame``, its
    ``centre_for(width, height)`` for the ``centre_px`` of point clouds. A file without the size of
    the images, such as a matrix as text, is for images of the size that it was made with.

    Args:
        path: the file.
        rectified: whether the images are rectified; their camera is that of the projection
            matrix, without distortion.

    Raises:
        InputError: the file cannot be read, is of several cameras, or holds no valid camera matrix.
    """
    path = paths.path_of(path)
    try:
        camera = _camera_in(path, rectified=rectified)
    except InputError:
        raise
    except Exception as error:  # of the libraries, and of numbers in odd places
        raise InputError(f"{path} is not a calibration that can be read", _ADVICE) from error
    return _checked(camera, path, rectified=rectified)


def camera_of_ros(info: Mapping[str, Any], path: Path, *, rectified: bool) -> Intrinsics:
    """The camera of a message ``CameraInfo`` in a bag, as :func:`read_calibration` gives it."""
    return _checked(_of_tree(info, path, rectified=rectified), path, rectified=rectified)


def _checked(camera: _Camera, path: Path, *, rectified: bool) -> Intrinsics:
    """The camera of numbers that make sense; InputError if they do not."""
    fx, fy, cx, cy = camera.matrix
    width, height = camera.size_px or (math.nan, math.nan)
    is_size = all(1 <= side <= _MAX_PX and side == int(side) for side in camera.size_px or ())
    is_near = CENTRE_PX.holds(cx) and CENTRE_PX.holds(cy)
    if not (is_size and is_near and FOCAL_PX.holds(fx) and FOCAL_PX.holds(fy)):
        raise InputError(
            f"{path} is for {width:g}×{height:g} pixels with fx {fx:g}, fy {fy:g}, cx {cx:g}, "
            f"cy {cy:g}, which is not a valid camera matrix; calibrate the camera again"
        )
    if max(fx, fy) < _NORMALIZED and not fx > width / 20:  # of which there are none
        problem = f"{path} has a focal length of {fx:g}, in widths of the image and not in pixels"
        raise InputError(problem, "multiply it and the principal point by the size")
    is_square = abs(fy / fx - 1) <= _SQUARE
    focal_px, aspect = (math.sqrt(fx * fy), 1.0) if is_square else (fx, fy / fx)
    size_px = (int(width), int(height)) if camera.size_px else None
    is_fisheye, lens = bool(_FISHEYE.search(camera.model)), camera.coefficients
    distortion = None
    if not rectified and (is_fisheye or any(lens)):  # OpenCV takes four coefficients or more
        filled = () if _OTHER_MODELS.search(camera.model) else (*lens, *[0.0] * (4 - len(lens)))
        distortion = Distortion(camera.matrix[:2], filled, is_fisheye)
    return Intrinsics(
        focal_px,
        hfov_deg=hfov_deg(focal_px, size_px[0]) if size_px else None,
        centre_px=(cx, cy),
        size_px=size_px,
        pixel_aspect=aspect,
        distortion=distortion,
    )


def _coefficients_in(tree: Mapping[str, Any]) -> tuple[tuple[float, ...], str]:
    """Coefficients of distortion in the order of its model, and that model's name."""
    model = next((str(tree[name]) for name in _MODELS if name in tree), "").lower()
    if 1 in {_number(tree.get(name)) for name in ("fisheye_model", "is_fisheye")}:  # OpenCV, NeRF
        model = "fisheye"
    named = {n: _number(tree[n]) for n in tree if _COEFFICIENTS.fullmatch(n)}
    if not any(named.values()):
        listed = numbers_in([tree[name] for name in tree if _DISTORTIONS.fullmatch(name)])
        return tuple(filter(math.isfinite, listed)), model
    order = _FISHEYE_ORDER if _FISHEYE.search(model) else _ORDER[: 8 if "k6" in named else 5]
    if any(named[name] for name in named if name not in order):
        return tuple(named.values()), "another"
    return tuple(named.get(name, 0) for name in order), model


def _camera_in(path: Path, *, rectified: bool) -> _Camera:
    data = paths.read_bytes(path)
    if len(data) > _MAX_BYTES:
        raise InputError(f"{path} is too large for a calibration; name another file")
    if path.suffix.lower() == ".bin":
        return _of_colmap(colmap_lines(data), path)
    text = data.decode("utf-8-sig")
    lines = [line.strip() for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    if lines and all(map(_COLMAP_LINE.fullmatch, lines)):
        return _of_colmap([line.split() for line in lines], path)
    rows = [numbers_in(re.sub(r"[\[\],;]", " ", line).split()) for line in lines]
    if [len(row) for row in rows] == [9]:  # as beside each image of KITTI
        rows = [rows[0][start : start + 3] for start in (0, 3, 6)]
    is_matrix = len(rows) in {3, 4} and all(len(row) == len(rows) for row in rows)
    if is_matrix and all(math.isfinite(number) for row in rows for number in row):
        return _Camera(_of_matrix(numbers_in(rows[:3]), len(rows), path))
    return _of_tree(dict(next(documents_in(text))), path, rectified=rectified)


def _of_tree(tree: Mapping[str, Any], path: Path, *, rectified: bool) -> _Camera:
    tree = _unwrapped(tree, path)
    size_px = _size_px(tree)
    projections = (*(_PROJECTIONS if rectified else ()), "P2", "P_rect_02")  # KITTI is rectified
    projection = next((tree[name] for name in projections if name in tree), None)
    if projection is not None:
        return _Camera(_of_matrix(numbers_in(projection), 4, path), size_px)
    if rectified:
        advice = "give {focal_px} and {centre_px} of the rectified images"
        raise InputError(f"{path} has no projection_matrix", advice)
    coefficients, model = _coefficients_in(tree)
    named = _of_named(tree, size_px)
    if named is not None:
        return replace(named, coefficients=coefficients, model=model)
    matrix = next((numbers_in(tree[name]) for name in (*_MATRICES, *_LISTS) if name in tree), None)
    if matrix is None or size_px is None:
        lacks = "camera_matrix" if matrix is None else "image_width and image_height"
        raise InputError(f"{path} has no {lacks}", _ADVICE)
    if any(name in tree for name in _LISTS) and 4 <= len(matrix) != 9:  # noqa: PLR2004
        fx, fy, cx, cy, *more = matrix
        return _Camera((fx, fy, cx, cy), size_px, coefficients or tuple(more), model)
    fx, fy, cx, cy = _of_matrix(matrix, 3, path)
    # ROS states the matrix for the whole sensor, also of images that are a part of it.
    roi = tree.get("roi") or {}
    x, y, *region = (_number(roi.get(name, 0)) for name in ("x_offset", "y_offset", *_SIZES[1]))
    if any(region):
        size_px = region[0], region[1]
    return _Camera((fx, fy, cx - x, cy - y), size_px, coefficients, model)


def _unwrapped(tree: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """The names of the only camera, of which programs have different groups and prefixes.

    Kalibr calls it cam0, ORB-SLAM Camera, FAST-LIVO2 cam; Open3D may have its pose beside it.
    """
    tree = {re.sub(r"Camera1?\.|^cam_", "", str(name)): value for name, value in tree.items()}
    tree |= tree.pop("projection_parameters", {})  # of VINS
    nested = [name for name in tree if re.fullmatch(r"cam\d+", name)]
    for names in (_LISTS, _GROUPS):
        nested = nested or [name for name in names if isinstance(tree.get(name), Mapping)]
    cameras = [tree.pop(name) for name in nested]
    for camera in cameras:
        is_pinhole = isinstance(camera, Mapping) and camera.get("camera_model") in {None, "pinhole"}
        if len(cameras) > 1 or not is_pinhole:
            raise InputError(f"{path} is not of one pinhole camera", "keep the one of the images")
        if "data" in camera:  # a matrix
            tree[nested[0]] = camera
        else:
            tree |= camera
    return tree


def _of_named(tree: Mapping[str, Any], size_px: tuple[float, float] | None) -> _Camera | None:
    """A camera whose numbers have names of their own, without its distortion."""
    if "fx" in tree:
        tree = {"cx": tree.get("ppx"), "cy": tree.get("ppy"), **tree}  # of RealSense
        fx, fy, cx, cy = (_number(tree.get(name)) for name in ("fx", "fy", "cx", "cy"))
        return _Camera((fx, fy, cx, cy), size_px)
    if "intrinsic_matrix" in tree:  # of Open3D, column by column
        numbers = numbers_in(tree["intrinsic_matrix"])
        fx, _, _, _, fy, _, cx, cy, *_ = [*numbers, *[math.nan] * 8]
        return _Camera((fx, fy, cx, cy), size_px)
    if ("fl_x" in tree or "camera_angle_x" in tree) and size_px is not None:  # of nerfstudio
        width, height = size_px
        angle = _number(tree.get("camera_angle_x"))
        fx = _number(tree.get("fl_x", width / 2 / math.tan(angle / 2)))
        others = (("fl_y", fx), ("cx", width / 2), ("cy", height / 2))
        fy, cx, cy = (_number(tree.get(name, default)) for name, default in others)
        return _Camera((fx, fy, cx - _CORNER, cy - _CORNER), size_px)
    return None


def _size_px(tree: Mapping[str, Any]) -> tuple[float, float] | None:
    """Columns and rows of the images; None if they are not stated."""
    for across, down in _SIZES:
        if across in tree and down in tree:
            return _number(tree[across]), _number(tree[down])
    for name in ("resolution", "S_rect_02", "ImageSize"):  # of Kalibr, KITTI, Autoware
        if name in tree:
            width, height, *_ = [*numbers_in(tree[name]), math.nan, math.nan]
            return width, height
    return None


def _of_matrix(numbers: list[float], columns: int, path: Path) -> tuple[float, float, float, float]:
    """fx, fy, cx and cy of a matrix of three rows."""
    if len(numbers) != 3 * columns or numbers[2 * columns :][:3] != [0, 0, 1]:
        raise InputError(
            f"{path} has a matrix whose last row is not 0 0 1", "write 3×3 or 3×4 numbers by rows"
        )
    return numbers[0], numbers[columns + 1], numbers[2], numbers[columns + 2]


def colmap_lines(data: bytes) -> list[list[str]]:
    """The lines of ``cameras.txt`` that a ``cameras.bin`` stands for."""
    lines, at = [], 8
    for _ in range(*struct.unpack_from("<Q", data)):
        number, model, width, height = struct.unpack_from("<iiQQ", data, at)
        name, count = _COLMAP_MODELS[model]
        parameters = struct.unpack_from(f"<{count}d", data, at := at + 24)
        at += 8 * count
        lines.append([str(number), name, str(width), str(height), *map(str, parameters)])
    return lines


def _of_colmap(lines: list[list[str]], path: Path) -> _Camera:
    if len(lines) != 1:
        raise InputError(f"{path} has {len(lines)} cameras", "keep the line of one in cameras.txt")
    _, model, width, height, *words = lines[0]
    parameters = numbers_in(words)
    if _ONE_FOCAL.match(model):
        parameters = parameters[:1] + parameters
    fx, fy, cx, cy, *distortion = parameters
    matrix, size_px = (fx, fy, cx - _CORNER, cy - _CORNER), (float(width), float(height))
    return _Camera(matrix, size_px, tuple(distortion), model.lower())


def documents_in(text: str) -> Iterator[Any]:
    """The names and values of JSON, XML or each document of YAML, in turn."""
    import yaml  # noqa: PLC0415 - takes 20 ms

    class Loader(yaml.SafeLoader):  # type: ignore[misc] # yaml has no types
        """Of OpenCV's files as well: a matrix is a mapping."""

    Loader.add_multi_constructor(
        "tag:yaml.org,2002:opencv-",
        lambda loader, _suffix, node: loader.construct_mapping(node, deep=True),
    )
    start = text.lstrip()[:1]
    if start == "{":
        yield parsed_json(text)
    elif start == "<":
        yield _of_element(ET.fromstring(text))  # noqa: S314 - expat limits entities
    else:
        # OpenCV writes a directive that is not one of YAML.
        yield from yaml.load_all(re.sub(r"\A\s*%YAML:.*\n", "", text), Loader)


def _of_element(element: ET.Element) -> Any:  # noqa: ANN401 - a mapping, or text
    if len(element):
        return {child.tag: _of_element(child) for child in element}
    return element.text or ""


def _number(value: Any) -> float:  # noqa: ANN401 - of any file
    """A number; NaN for anything else."""
    numbers = numbers_in(value)
    return numbers[0] if len(numbers) == 1 else math.nan


def numbers_in(value: Any) -> list[float]:  # noqa: ANN401 - of any file
    """The numbers of a matrix or a list, row by row; NaN for what is none."""
    if isinstance(value, Mapping):
        return numbers_in(value["data"] if "data" in value else list(value.values()))
    value = value.tolist() if hasattr(value, "tolist") else value  # of a message of ROS
    if isinstance(value, list | tuple):
        return [number for part in value for number in numbers_in(part)]
    if isinstance(value, str) and len(words := value.split()) != 1:
        return [number for word in words for number in numbers_in(word)]
    try:  # YAML 1.1 takes 1e-05 for a text
        return [float(value)]
    except (TypeError, ValueError, OverflowError):
        return [math.nan]


ID = "id"
_FOCAL = frozenset({"focal_px", "hfov_deg"})
_RULES = {"focal_px": FOCAL_PX, "hfov_deg": HFOV_DEG, "cx": CENTRE_PX, "cy": CENTRE_PX}
_MAX_TABLE_BYTES = 256 * 2**20


def read_lenses(path: Path) -> dict[str, Intrinsics]:
    """The camera of each id.

    The first line names the columns: ``id``, and ``focal_px`` (pixels of the image), ``hfov_deg``
    (horizontal field of view in degrees) or both. In a row with both, ``focal_px`` counts. ``cx``
    and ``cy``, the principal point in pixels of the image, are optional. A row without any of
    these is left out. Other columns are ignored.
    """
    with os_errors_as(InputError, f"{path} cannot be read"):
        data = paths.read_regular(path, _MAX_TABLE_BYTES)
    table = CsvTable(data, str(path))
    if ID not in table.columns or _FOCAL.isdisjoint(table.columns):
        raise InputError(f"{path} has no columns id,focal_px or id,hfov_deg in its first line")
    lenses: dict[str, Intrinsics] = {}
    for row in table:
        focal_px, hfov_deg, cx, cy = (
            row.number(column, rule) if row.cells.get(column) else None
            for column, rule in _RULES.items()
        )
        if (cx is None) != (cy is None):
            raise row.error("give cx and cy, or neither")
        centre_px = None if cx is None or cy is None else (cx, cy)
        lens = Intrinsics(focal_px, None if focal_px is not None else hfov_deg, centre_px)
        if lens == UNKNOWN_CAMERA:
            continue
        name = row.cells[ID].removeprefix("./")
        if not name:
            raise row.error("the id is missing")
        if lenses.setdefault(name, lens) != lens:
            raise row.error(f"another row of {short_repr(name)} has another camera")
    return lenses


_KEPT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_PAIR = Rule("a list of two", lambda values: len(values) == 2)  # noqa: PLR2004


@dataclass(frozen=True, slots=True)
class _KeptCamera:
    """The fields of a camera's file beside those of its scale; in 0.22 the first alone."""

    hfov_deg: float | None = None
    centre_px: Annotated[tuple[float, ...], _PAIR] | None = None
    size_px: Annotated[tuple[int, ...], _PAIR] | None = None
    pixel_aspect: float | None = None
    distortion: tuple[Any, ...] | None = None


def keep_camera(scale: CameraScale, camera: Intrinsics) -> Path:
    """Write a camera, whose scale was measured; an earlier one of the name is replaced."""
    path = _kept_path(scale.name)
    names = _KeptCamera.__slots__
    document = {name: getattr(camera, name) for name in names} | asdict(scale)
    try:
        atomic.write_text(json.dumps(document, indent=2) + "\n", path)
    except OutputError as error:
        advice = "name a folder that can be written in XDG_CONFIG_HOME"
        raise OutputError(error.message.problem, advice) from error
    return path


def kept_camera(name: str) -> Intrinsics:
    """The camera of a name."""
    path = _kept_path(name)
    try:
        document: Any = parsed_json(paths.read_regular(path, _MAX_BYTES))
        fields = {name: document.pop(name, None) for name in _KeptCamera.__slots__}
        camera: Any = validated(_KeptCamera, fields)
        size_px = camera.size_px
        kinds: Any = Annotated[tuple[float, ...], _PAIR], tuple[float, ...], bool
        lens = [validated(*part) for part in zip(kinds, camera.distortion or (), strict=False)]
        return Intrinsics(
            Intrinsics(hfov_deg=camera.hfov_deg).focal_for(*size_px) if size_px else None,
            camera.hfov_deg,
            camera.centre_px,
            size_px,
            camera.pixel_aspect,
            distortion=Distortion(*lens) if lens else None,
            is_undistorted=bool(lens),
            scale=validated(CameraScale, document),
        )
    except FileNotFoundError as error:
        there = sorted(file.stem for file in path.parent.glob("*.json"))
        choice = f"there are {', '.join(there)}" if there else "there is none"
        raise UsageError(
            f"no camera named {name!r}: {choice}", "make it with 'depthcli calibrate'"
        ) from error
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise UsageError(
            f"{path} is no calibrated camera: {error}", "calibrate it again"
        ) from error


def _kept_path(name: str) -> Path:
    if not _KEPT_NAME.fullmatch(name):
        raise UsageError(f"{name!r} is not a name of letters, digits, '-', '_' and '.'")
    return paths.user_folder("config") / "cameras" / f"{name}.json"
