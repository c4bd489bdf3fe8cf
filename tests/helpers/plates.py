"""Plates: EXR images with overscan, crops and non-square pixels, and their depth."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from depthcli.io.exr.file import ExrPart, StoredChannel, choose_depth

Box = tuple[int, int, int, int]
"""First and last column and row, as headers state them: left, top, right, bottom."""
DISPLAY: Box = (100, 50, 163, 97)
OVERSCAN: Box = (92, 46, 171, 99)
CROP: Box = (110, 60, 149, 79)
MIXED: Box = (90, 60, 149, 105)


def size_of(box: Box) -> tuple[int, int]:
    return box[3] - box[1] + 1, box[2] - box[0] + 1


def inside(box: Box, outer: Box) -> tuple[slice, slice]:
    """Rows and columns of a box in an array over an outer one."""
    height, width = size_of(box)
    top, left = box[1] - outer[1], box[0] - outer[0]
    return slice(top, top + height), slice(left, left + width)


def write_plate(
    folder: Path, number: int, data: Box, display: Box = DISPLAY, aspect: float = 1
) -> Path:
    """Linear light that grows with x and y, which are those of the file."""
    folder.mkdir(exist_ok=True)
    y, x = np.mgrid[data[1] : data[3] + 1, data[0] : data[2] + 1]
    light = ((x - 80 + y - 40) / 200 + number % 10 / 50).clip(0, 1).astype(np.float32)
    header = {
        "type": OpenEXR.scanlineimage,
        "dataWindow": (data[:2], data[2:]),
        "displayWindow": (display[:2], display[2:]),
        "pixelAspectRatio": float(aspect),
        "framesPerSecond": Fraction(24),
        "timeCode": OpenEXR.TimeCode(*time_code_of(number)),
    }
    path = folder / f"plate.{number}.exr"
    OpenEXR.File(header, dict.fromkeys("RGB", light)).write(str(path))
    return path


def time_code_of(number: int) -> tuple[int, ...]:
    """Of a plate; binary groups and flags that do not depend on the frame are carried, too."""
    return (1, 2, 3, number % 24, 1, 0, 1, 0, 0, 1, *range(1, 9))


def written(path: Path) -> tuple[Box, Box, float, np.ndarray[Any, Any]]:
    """Data window, display window, pixel aspect and depth of a file, as OpenEXR reads it."""
    file = OpenEXR.File(str(path))
    header = file.header()
    boxes = [tuple(map(int, np.ravel(header[f"{window}Window"]))) for window in ("data", "display")]
    return (*boxes, header["pixelAspectRatio"], file.channels()["Y"].pixels)


def depth_channel(names: Iterable[str]) -> str | None:
    """The channel of depth among channels of a file of one part."""
    header = {window: (np.zeros(2), np.zeros(2)) for window in ("dataWindow", "displayWindow")}
    part = ExrPart.of({**header, "pixelAspectRatio": 1.0})
    channels = {name: StoredChannel(np.zeros((1, 1)), part) for name in names}
    return choose_depth("a.exr", channels)[0]
