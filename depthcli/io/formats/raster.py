"""Floats of other programs: PFM (stereo and MVS), TIFF, and the dense maps of COLMAP."""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from depthcli.core.arrays import AnyArray
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, Message
from depthcli.io.images import tiff
from depthcli.io.images.read import OPENCV_MAX_PIXELS, check
from depthcli.io.storage.paths import read_bytes
from depthcli.io.stored.depth import DepthReadOptions, StoredDepth

_PFM = re.compile(rb"Pf\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]+)(?:\r\n|\s)")
COLMAP_MAP = re.compile(rb"(\d{1,9})&(\d{1,9})&\d{1,9}&")
_COLMAP_DEPTH = re.compile(rb"(\d{1,9})&(\d{1,9})&0*1&")
_TIFF_UNCOMPRESSED = 1


@dataclass(frozen=True, slots=True)
class FloatWriter:
    """PFM, uncompressed TIFF or COLMAP's dense map, by the suffix of the file."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write (H, W) float32 as it is; no depth is infinite in PFM, 0 in COLMAP's maps.

        The formats have no room for what the numbers mean, which is a warning if they have no unit.
        """
        del frame
        suffix, values = path.suffix.lower(), np.ascontiguousarray(depth.values, "<f4")
        if suffix == ".pfm":  # rows from the bottom
            pfm_values = np.where(np.isnan(values), np.float32(np.inf), values)
            data = f"Pf\n{depth.width} {depth.height}\n-1.0\n".encode() + pfm_values[::-1].tobytes()
        elif suffix == ".bin":
            data = f"{depth.width}&{depth.height}&1&".encode()
            data += np.nan_to_num(values, posinf=0).tobytes()
        else:
            settings = [cv2.IMWRITE_TIFF_COMPRESSION, _TIFF_UNCOMPRESSED]
            data = cv2.imencode(".tiff", values, settings)[1].tobytes()
        path.write_bytes(data)
        problem = f"{depth.kind} depth has no unit, which {suffix[1:]} cannot say"
        return () if depth.is_metric else (Message(problem, "{sidecar} does"),)


def read(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Depth of a gray file of any program, in the format that its suffix names."""
    suffix, data, several = path.suffix.lower(), read_bytes(path), None
    if suffix in {".pfm", ".bin"}:
        values = _plain_floats(data, path)
    else:
        image = check(data, str(path), OPENCV_MAX_PIXELS)
        values, several = image.decode().pixels, image.header.warning
        no_data = tiff.no_data_value(data)
        np.putmask(values, values == no_data, 0 if values.dtype.kind in "iu" else math.nan)
    if values.ndim != 2 or values.dtype == np.uint8:  # noqa: PLR2004
        raise InputError(f"{path} is an image, not gray of 16 bits or more, so it holds no depth")
    result = StoredDepth.of(path, values, {}, options)
    if several:  # pages of a TIFF
        result = replace(result, warnings=(*result.warnings, f"{path} {several}"))
    if suffix != ".bin" or result.scale is None or result.scale.source != "assumed":
        return result
    unit = Message("COLMAP's unit is arbitrary, and it is taken for metres", "state its scale")
    return replace(result, warnings=(*result.warnings, unit))


def _plain_floats(data: bytes, path: Path) -> AnyArray:
    """The pixels of a PFM, whose scale (Middlebury's is 1/255) OpenCV would multiply, or COLMAP."""
    is_pfm = path.suffix.lower() == ".pfm"
    head = (_PFM if is_pfm else _COLMAP_DEPTH).match(data)
    if head is None:
        kind = "gray portable float map" if is_pfm else "dense map of COLMAP of one channel"
        raise InputError(f"{path} is not a {kind}, so it holds no depth")
    width, height = int(head[1]), int(head[2])
    if not width or not height or len(data) - head.end() < 4 * width * height:
        raise InputError(f"{path} is truncated or damaged", "copy it again")
    order = ">f4" if is_pfm and not head[3].startswith(b"-") else "<f4"
    values = np.frombuffer(data, order, width * height, head.end()).reshape(height, width)
    return values[::-1] if is_pfm else values
