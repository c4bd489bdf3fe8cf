"""Writing OpenEXR files, and reading their headers."""

import struct
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy.typing as npt
import OpenEXR

from depthcli.core.windows import Window
from depthcli.errors import InputError
from depthcli.io.depth.exr_library import OPENEXR_ERRORS, silenced, utf8_name
from depthcli.io.depth.time_code import time_code_attribute
from depthcli.io.pictures.decode import read_bytes

_FIRST_ATTRIBUTE, _ROWS_A_BLOCK, _HEAD_BYTES = 8, 16, 1 << 20


def write_exr(
    path: Path,
    channels: Mapping[str, npt.NDArray[Any]],
    texts: Mapping[str, str],
    rate: Fraction | None = None,
    *,
    pixel_aspect: float = 1.0,
    windows: tuple[Window, Window] | None = None,
    time_code: tuple[int, ...] | None = None,
) -> None:
    """Write one part, ZIP-compressed.

    Args:
        path: the file.
        channels: (H, W) float32 or float16 by name.
        texts: text attributes by name.
        rate: frames a second of the sequence that the file belongs to.
        pixel_aspect: width by height of a pixel, from 1e-6 to 1e6.
        windows: the data window, which the channels cover, and the display window; None if both
            begin at (0, 0) and are of the channels' size.
        time_code: of the frame, as ``Frame`` has it; None for none.

    Raises:
        OSError: the file cannot be written.
    """
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "pixelAspectRatio": pixel_aspect,
        **texts,
    }
    if windows is not None:
        header |= zip(("dataWindow", "displayWindow"), map(_corners, windows), strict=True)
    if rate is not None:
        header["framesPerSecond"] = rate  # which OpenEXR stores as its rational
    if time_code is not None:
        header["timeCode"] = time_code_attribute(time_code)
    try:
        with utf8_name(path) as name:
            OpenEXR.File(header, dict(channels)).write(name)
    except RuntimeError as error:
        # 'Failed to ... image file "name". No space left on device.'
        raise OSError(str(error).rpartition('". ')[2].rstrip(".")) from error
    if not _has_all_rows(path, len(next(iter(channels.values())))):
        raise OSError("its end did not reach the disk, which may be full")


def _corners(window: Window) -> tuple[tuple[int, int], tuple[int, int]]:
    """The first and the last pixel of a window, as headers name them."""
    return (window.left, window.top), (window.right - 1, window.bottom - 1)


def _has_all_rows(path: Path, height: int) -> bool:
    """Whether a file of one part has all its rows: OpenEXR reports no error if they are missing."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
        try:
            at = _FIRST_ATTRIBUTE
            while head[at]:  # name, type, size and value of an attribute
                at = head.index(0, head.index(0, at) + 1) + 1
                at += 4 + int.from_bytes(head[at : at + 4], "little")
            offsets = struct.unpack_from(f"<{-(-height // _ROWS_A_BLOCK)}Q", head, at + 1)
        except (IndexError, ValueError, struct.error):
            return False
        file.seek(offsets[-1] + 4)
        size = int.from_bytes(file.read(4), "little")
    return all(offsets) and path.stat().st_size == offsets[-1] + 8 + size


def read_exr_texts(path: Path) -> dict[str, str]:
    """Text attributes of the first part.

    Raises:
        InputError: missing or damaged.
    """
    header = read_exr_header(path)
    return {name: value for name, value in header.items() if isinstance(value, str)}


def read_exr_header(path: Path) -> dict[str, Any]:
    """All attributes of the first part.

    Raises:
        InputError: missing or damaged.
    """
    read_bytes(path)
    try:
        with utf8_name(path) as name, silenced():
            header: dict[str, Any] = OpenEXR.File(name, header_only=True).header()
            return header
    except OPENEXR_ERRORS as error:
        raise InputError(f"{path} is not an EXR file that can be read") from error
