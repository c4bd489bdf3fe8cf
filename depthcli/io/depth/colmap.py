"""The sparse points of a reconstruction by COLMAP as known depth of its images."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePath

import numpy as np
import numpy.typing as npt

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import DEPTH_M_RANGE
from depthcli.errors import InputError, Message
from depthcli.io.calibration import colmap_lines
from depthcli.io.storage.paths import read_bytes

_TRIPLE = 3  # column, row and point of an observation

_Values = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Image:
    """What a reconstruction knows of an image."""

    pose: tuple[float, ...]  #: quaternion w, x, y, z and translation, from the world to the camera
    camera: int
    #: (N, 3): column and row from the corner of the first pixel, and point; -1 for none
    seen: _Values


@dataclass(frozen=True, slots=True)
class _Reconstruction:
    sizes_px: dict[int, tuple[int, int]]  #: columns and rows of the images of each camera
    images: dict[str, _Image]  #: by their paths
    points: dict[int, tuple[float, float, float]]  #: places in the world


def read_reconstruction(
    files: tuple[Path, ...], image: Path, units_per_m: float | None
) -> AnchorPoints:
    """The points that were seen in an image, whose path ends in one that the files state.

    These are of cameras, images and points, binary or text; without ``units_per_m`` in their unit.
    """
    found = _read(files, tuple(file.stat().st_mtime_ns for file in files))
    folder = files[0].parent
    parts = PurePath(image).parts
    names = [n for n in found.images if parts[-len(PurePath(n).parts) :] == PurePath(n).parts]
    if not names:
        raise InputError(f"{folder} has no image {image.name}")
    seen_in = found.images[max(names, key=len)]
    rows = [row for row in seen_in.seen.tolist() if int(row[2]) in found.points]
    places = np.array([found.points[int(row[2])] for row in rows]).reshape(-1, 3)
    depth = places @ _third_row(*seen_in.pose[:4]) + seen_in.pose[6]
    depth_m = depth / (units_per_m or 1)
    is_before = (depth_m >= DEPTH_M_RANGE[0]) & (depth_m <= DEPTH_M_RANGE[1])
    if not is_before.any():
        raise InputError(f"{folder} has no points of {image.name}")
    x, y = np.floor(np.array(rows)[is_before, :2]).astype(np.int64).T  # from the corner
    unit = Message(
        f"depth is in the unit of {folder}, which is not known",
        "{anchors_scale} states how many of it are a metre",
    )
    warnings: list[str] = [unit] * (units_per_m is None)
    lost = len(rows) - int(is_before.sum())
    warnings += [f"{lost} of {len(rows)} points are behind the camera and are not used"] * (
        lost > 0
    )
    size_px = found.sizes_px[seen_in.camera]
    return AnchorPoints(x, y, depth_m[is_before], size_px, tuple(warnings))


def _third_row(w: float, x: float, y: float, z: float) -> _Values:
    """The row of a rotation that gives distances along the axis of the camera: (3,)."""
    return np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


@lru_cache(maxsize=1)  # for all images of a batch
def _read(files: tuple[Path, ...], changed: tuple[int, ...]) -> _Reconstruction:
    del changed
    data = [read_bytes(file) for file in files]
    try:
        if files[0].suffix == ".bin":
            cameras, images, points = colmap_lines(data[0]), _images(data[1]), _points(data[2])
        else:
            texts = [one.decode() for one in data]
            cameras = [line.split() for line in _lines(texts[0]) if line.strip()]
            images, points = _images_of_text(texts[1]), _points_of_text(texts[2])
        sizes_px = {int(words[0]): (int(words[2]), int(words[3])) for words in cameras}
        return _Reconstruction(sizes_px, dict(images), dict(points))
    except (ValueError, IndexError, struct.error) as error:
        raise InputError(
            f"{files[0].parent} is not a reconstruction of COLMAP that can be read"
        ) from error


def _images(data: bytes) -> Iterator[tuple[str, _Image]]:
    at = 8
    for _ in range(*struct.unpack_from("<Q", data)):
        pose, camera = (
            struct.unpack_from("<7d", data, at + 4),
            *struct.unpack_from("<I", data, at + 60),
        )
        end = data.index(b"\0", at := at + 64)
        name = data[at:end].decode()
        (count,) = struct.unpack_from("<Q", data, end + 1)
        kinds = np.dtype([("pixel", "<2f8"), ("point", "<i8")])
        seen = np.frombuffer(data, kinds, count, end + 9)
        at = end + 9 + count * kinds.itemsize
        yield name, _Image(pose, camera, np.column_stack([seen["pixel"], seen["point"]]))


def _points(data: bytes) -> Iterator[tuple[int, tuple[float, float, float]]]:
    at = 8
    for _ in range(*struct.unpack_from("<Q", data)):
        number, *place = struct.unpack_from("<Q3d", data, at)
        (views,) = struct.unpack_from("<Q", data, at + 43)  # after colour and error
        at += 51 + 8 * views
        yield number, tuple(place)


def _lines(text: str) -> Iterator[str]:
    return (line for line in text.splitlines() if not line.startswith("#"))


def _images_of_text(text: str) -> Iterator[tuple[str, _Image]]:
    """Two lines an image, of which the second is empty if nothing was seen."""
    lines = _lines(text)
    for line in lines:
        if line.strip():
            _, *numbers, camera, name = line.split(maxsplit=9)
            seen = np.array(next(lines, "").split(), np.float64).reshape(-1, _TRIPLE)
            yield name.strip(), _Image(tuple(map(float, numbers)), int(camera), seen)


def _points_of_text(text: str) -> Iterator[tuple[int, tuple[float, float, float]]]:
    for line in _lines(text):
        if line.strip():
            number, x, y, z, *_ = line.split(maxsplit=4)
            yield int(number), (float(x), float(y), float(z))
