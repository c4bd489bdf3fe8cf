"""Floats of other programs: PFM (stereo and MVS), TIFF, and the dense maps of COLMAP."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, Message
from depthcli.io.depth.read import DepthReadOptions, StoredDepth, stored_depth
from depthcli.io.images.read import OPENCV_MAX_PIXELS, decode
from depthcli.io.storage.paths import read_bytes

_PFM = re.compile(rb"(P[Ff])\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]+)\s")
_COLMAP = re.compile(rb"(\d{1,9})&(\d{1,9})&(\d{1,9})&")
_TIFF_UNCOMPRESSED = 1


class _FloatWriter:
    """Float32 with the values as they are; the format has no room for what they mean."""

    __slots__ = ()

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the values; a warning says what the file cannot."""
        del frame
        path.write_bytes(self.encoded(np.ascontiguousarray(depth.values, "<f4")))
        problem = f"{depth.kind} depth has no unit, which {path.suffix[1:]} cannot say"
        return () if depth.is_metric else (Message(problem, "{sidecar} does"),)

    def encoded(self, values: npt.NDArray[np.float32]) -> bytes:
        """The bytes of a file, of (H, W) little-endian float32."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class PfmWriter(_FloatWriter):
    """Portable float map, rows from the bottom; infinite where there is no depth."""

    def encoded(self, values: npt.NDArray[np.float32]) -> bytes:  # noqa: D102 - as above
        height, width = values.shape
        known = np.where(np.isnan(values), np.float32(np.inf), values)
        return f"Pf\n{width} {height}\n-1.0\n".encode() + known[::-1].tobytes()


@dataclass(frozen=True, slots=True)
class TiffWriter(_FloatWriter):
    """Uncompressed TIFF of one float channel."""

    def encoded(self, values: npt.NDArray[np.float32]) -> bytes:  # noqa: D102 - as above
        settings = [cv2.IMWRITE_TIFF_COMPRESSION, _TIFF_UNCOMPRESSED]
        return cv2.imencode(".tiff", values, settings)[1].tobytes()


@dataclass(frozen=True, slots=True)
class ColmapWriter(_FloatWriter):
    """Dense depth map of COLMAP, ``images.jpg.geometric.bin``; 0 where there is no depth."""

    def encoded(self, values: npt.NDArray[np.float32]) -> bytes:  # noqa: D102 - as above
        height, width = values.shape
        return f"{width}&{height}&1&".encode() + np.nan_to_num(values, posinf=0).tobytes()


def read(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of a gray file of any program, in the format that its suffix names.

    Raises:
        InputError: it cannot be read, or is not gray.
    """
    suffix, data = path.suffix.lower(), read_bytes(path)
    if suffix == ".pfm":
        values = _pfm(data, path)
    elif suffix == ".bin":
        values = _colmap(data, path)
    else:
        values = decode(data, str(path), max_pixels=OPENCV_MAX_PIXELS)
    if values.ndim != 2 or values.dtype == np.uint8:  # noqa: PLR2004
        raise InputError(f"{path} is a picture, not gray of 16 bits or more, so it holds no depth")
    found = stored_depth(path, values, {}, options)
    if suffix != ".bin" or found.scale is None or found.scale.source != "assumed":
        return found
    unit = Message("COLMAP's unit is arbitrary, and it is taken for metres", "state its scale")
    return replace(found, warnings=(*found.warnings, unit))


def _pfm(data: bytes, path: Path) -> npt.NDArray[Any]:
    """The pixels of a PFM, whose scale OpenCV would multiply: Middlebury's is 1/255."""
    head = _PFM.match(data)
    if head is None:
        raise InputError(f"{path} is not a portable float map that can be read")
    kind, width, height, scale = head.groups()
    if kind != b"Pf":
        raise InputError(f"{path} is not gray, so it holds no depth")
    order = "<f4" if scale.startswith(b"-") else ">f4"
    return _floats(data[head.end() :], order, int(width), int(height), path)[::-1]


def _colmap(data: bytes, path: Path) -> npt.NDArray[Any]:
    head = _COLMAP.match(data)
    if head is None:
        raise InputError(f"{path} is not a dense map of COLMAP")
    width, height, channels = head.groups()
    if int(channels) != 1:
        raise InputError(f"{path} holds {int(channels)} channels, as normals have, not depth")
    return _floats(data[head.end() :], "<f4", int(width), int(height), path)


def _floats(data: bytes, order: str, width: int, height: int, path: Path) -> npt.NDArray[Any]:
    if not width or not height or len(data) < 4 * width * height:
        raise InputError(f"{path} is truncated or damaged", "copy it again")
    return np.frombuffer(data, order, width * height).reshape(height, width)
