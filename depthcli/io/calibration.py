"""Reading camera calibrations of ROS and OpenCV."""

import math
import os
from itertools import dropwhile, takewhile
from pathlib import Path

import cv2

from depthcli.core.camera import FOCAL_PX, Intrinsics, hfov_deg
from depthcli.errors import InputError
from depthcli.io.images import opencv as _silenced  # noqa: F401 - its log
from depthcli.io.storage.paths import path_of, read_bytes

_WIDTHS, _HEIGHTS = ("image_width", "width"), ("image_height", "height")
_MATRICES = ("camera_matrix", "K", "k")
_PROJECTIONS = ("projection_matrix", "P", "p")
_DISTORTIONS = ("distortion_coefficients", "dist_coeffs", "D", "d", "fisheye_model")
"""Nodes with a number that is not 0 if there is distortion."""
_LAST_ROW = [0, 0, 1]
_ADVICE = "name the calibration of a camera"
_MAX_BYTES = 2**20
_MAX_PX = 1e6
_SQUARE = 0.01  # largest difference of fx and fy of square pixels, as a share
_OTHERS = (b"<?xml", b"{")
_ENDS = (b"---", b"...")
"""Lines at which a YAML document ends."""


def read_calibration(path: str | os.PathLike[str], *, rectified: bool = False) -> Intrinsics:
    """A calibration in ``camera_info`` YAML of ROS, or in YAML, XML or JSON of OpenCV.

    Of a ``CameraInfo`` with a region of interest, it is the camera of the pictures of that region.
    Its focal length is the geometric mean of fx and fy, or fx if they differ by more than 1 %. Its
    ``hfov_deg`` is for ``predict``, its ``pixel_aspect`` for a ``Frame``, its
    ``centre_for(width, height)`` for the ``centre_px`` of point clouds.

    Args:
        path: the file.
        rectified: whether the pictures are rectified; their camera is that of the projection
            matrix, without distortion.

    Raises:
        InputError: the file cannot be read, or lacks the size of the pictures or the matrix, or
            they are not those of a camera.
    """
    path = path_of(path)
    root = _opened_storage(path)
    size = [_numbers(_node(root, names, path)) for names in (_WIDTHS, _HEIGHTS)]
    width, height = (numbers[0] if len(numbers) == 1 else math.nan for numbers in size)
    (fx, _, cx), (_, fy, cy) = _matrix_rows(root, path, rectified=rectified)
    x, y, *region = _region_of_interest(root)
    cx, cy = cx - x, cy - y
    width, height = region if any(region) else (width, height)
    is_size = all(1 <= side <= _MAX_PX and side == int(side) for side in (width, height))
    # A crop can have it outside, but hardly by more than its own size.
    is_near = -width <= cx <= 2 * width and -height <= cy <= 2 * height
    if not (is_size and is_near and FOCAL_PX.holds(fx) and FOCAL_PX.holds(fy)):
        raise InputError(
            f"{path} is for {width:g}×{height:g} pixels with fx {fx:g}, fy {fy:g}, cx {cx:g}, "
            f"cy {cy:g}, which is not a valid camera matrix; calibrate the camera again"
        )
    is_square = abs(fy / fx - 1) <= _SQUARE
    focal_px, aspect = (math.sqrt(fx * fy), 1.0) if is_square else (fx, fy / fx)
    is_distorted = not rectified and _is_distorted(root)
    return Intrinsics(
        focal_px,
        hfov_deg=hfov_deg(focal_px, int(width)),
        centre_px=(cx, cy),
        size_px=(int(width), int(height)),
        pixel_aspect=aspect,
        is_distorted=is_distorted,
    )


def _matrix_rows(root: cv2.FileStorage, path: Path, *, rectified: bool) -> list[list[float]]:
    """The first two rows of the camera matrix, or of that in the projection matrix."""
    names, columns = (_PROJECTIONS, 4) if rectified else (_MATRICES, 3)
    advice = "give {focal_px} and {centre_px} of the rectified pictures" if rectified else _ADVICE
    numbers = _numbers(_node(root, names, path, advice))
    rows = [numbers[start : start + 3] for start in range(0, len(numbers), columns)]
    if len(numbers) != 3 * columns or rows[2] != _LAST_ROW:
        raise InputError(
            f"{path} has a {names[0]} that is not 3×{columns} with 0 0 1 in the last row; write "
            "it row by row, or calibrate the camera again"
        )
    return rows[:2]


def _region_of_interest(root: cv2.FileStorage) -> list[float]:
    """Column, row, width and height in pixels of the whole sensor; zeros for all of it.

    ROS states the matrix for the whole sensor, also of pictures that are a part of it.
    """
    roi = root.getNode("roi")
    if not roi.isMap():
        return [0.0] * 4
    nodes = [roi.getNode(name) for name in ("x_offset", "y_offset", "width", "height")]
    return [0.0 if node.isNone() else (_numbers(node) or [math.nan])[0] for node in nodes]


def _is_distorted(root: cv2.FileStorage) -> bool:
    named = [root.getNode(name) for name in _DISTORTIONS]
    return any(any(_numbers(node)) for node in named if not node.isNone())


def _opened_storage(path: Path) -> cv2.FileStorage:
    data = read_bytes(path)
    if len(data) > _MAX_BYTES:
        raise InputError(f"{path} is too large for a calibration; name another file")
    if not data.startswith(_OTHERS):
        # ROS writes no header, and versions of OpenCV differ in theirs. A topic has an end.
        lines = data.removeprefix(b"\xef\xbb\xbf").splitlines()
        rest = dropwhile(_is_before_document, lines)
        document = takewhile(lambda line: line.rstrip() not in _ENDS, rest)
        data = b"\n".join([b"%YAML:1.0", b"---", *document, b""])
    try:
        flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
        root = cv2.FileStorage(data.decode(), flags)
        is_read = root.isOpened() and root.root().isMap()
    except (cv2.error, SystemError, UnicodeDecodeError):
        is_read = False
    if not is_read:
        raise InputError(
            f"{path} is not a calibration that OpenCV can read: YAML of ROS with lists as [1, 2] "
            "(ros2 topic echo --flow-style) and without comments behind values, or YAML, XML or "
            "JSON of OpenCV"
        )
    return root


def _is_before_document(line: bytes) -> bool:
    return line.startswith(b"%YAML") or line.strip() in {b"", b"---"}


def _node(
    root: cv2.FileStorage, names: tuple[str, ...], path: Path, advice: str = _ADVICE
) -> cv2.FileNode:
    for name in names:
        node = root.getNode(name)
        if not node.isNone():
            return node
    raise InputError(f"{path} has no {names[0]}", advice)


def _numbers(node: cv2.FileNode) -> list[float]:
    """The numbers of a matrix, row by row; NaN for what is none."""
    if node.isMap():
        return _numbers(node.getNode("data"))
    if node.isSeq():
        return [number for i in range(node.size()) for number in _numbers(node.at(i))]
    return [float(node.real()) if node.isInt() or node.isReal() else math.nan]
