"""Reading and writing OpenEXR files, with paths of any bytes and one kind of error."""

import os
import struct
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from fractions import Fraction
from pathlib import Path
from typing import Any, TextIO, cast

import numpy as np
import numpy.typing as npt
import OpenEXR

from depthcli.core.choices import MAX_PIXELS
from depthcli.errors import InputError
from depthcli.io.pictures.decode import read_bytes
from depthcli.io.pictures.decoder_messages import decoder_messages
from depthcli.io.storage.remote import RemotePath
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.io.storage.transfer import local_copy

_FIRST_ATTRIBUTE, _ROWS_A_BLOCK, _HEAD_BYTES = 8, 16, 1 << 20
_LOCK = threading.Lock()  # standard output is redirected meanwhile
_OPENEXR_ERRORS = (RuntimeError, ValueError, TypeError, OSError, MemoryError)


def write_exr(
    path: Path,
    channels: Mapping[str, npt.NDArray[Any]],
    texts: Mapping[str, str],
    rate: Fraction | None = None,
) -> None:
    """Write one part, ZIP-compressed.

    Args:
        path: the file.
        channels: (H, W) float32 or float16 by name.
        texts: text attributes by name.
        rate: frames a second of the sequence that the file belongs to.

    Raises:
        OSError: the file cannot be written.
    """
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **texts}
    if rate is not None:
        header["framesPerSecond"] = rate  # which OpenEXR stores as its rational
    try:
        with _utf8_name(path) as name:
            OpenEXR.File(header, dict(channels)).write(name)
    except RuntimeError as error:
        # 'Failed to ... image file "name". No space left on device.'
        raise OSError(str(error).rpartition('". ')[2].rstrip(".")) from error
    if not _has_all_rows(path, len(next(iter(channels.values())))):
        raise OSError("its end did not reach the disk, which may be full")


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
        with _utf8_name(path) as name, _silenced():
            return dict(OpenEXR.File(name, header_only=True).header())
    except _OPENEXR_ERRORS as error:
        raise InputError(f"{path} is not an EXR file that can be read") from error


def read_exr_channels(path: Path) -> dict[str, npt.NDArray[np.float32]]:
    """All channels of all parts, (H, W) float32 over the display window, NaN outside the data.

    In a file of several parts, a part's name precedes the names of its channels.

    Raises:
        InputError: missing, damaged, or too large.
    """
    read_bytes(path)
    channels: dict[str, npt.NDArray[np.float32]] = {}
    problem = "is not an EXR file that can be read"
    try:
        with _utf8_name(path) as name, _silenced():
            for part in OpenEXR.File(name, header_only=True).parts:
                _check_pixel_count(path, part.header)
            problem = "is damaged: its pixels cannot be read; copy it again"
            parts = OpenEXR.File(name, separate_channels=True).parts
        if not parts or not all(part.channels for part in parts):  # all that becomes of damage
            raise InputError(f"{path} {problem}")
        for part in parts:
            layer = f"{part.header['name']}." if len(parts) > 1 else ""
            for channel, content in part.channels.items():
                channels[layer + channel] = _in_display_window(content.pixels, part.header)
    except _OPENEXR_ERRORS as error:
        raise InputError(f"{path} {problem}") from error
    return channels


def _check_pixel_count(path: Path, header: dict[str, Any]) -> None:
    for window in ("dataWindow", "displayWindow"):
        width, height = _window_size(header[window])
        if width * height > MAX_PIXELS:
            raise InputError(f"{path} claims {width}×{height} pixels, more than {MAX_PIXELS:,}")


def _window_size(window: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]) -> tuple[int, int]:
    (left, top), (right, bottom) = (map(int, corner) for corner in window)
    return right - left + 1, bottom - top + 1


def _in_display_window(pixels: npt.NDArray[Any], header: dict[str, Any]) -> npt.NDArray[np.float32]:
    """Pixels over the whole display window: renderers store only the part that has content."""
    values = np.ascontiguousarray(pixels, np.float32)
    data, display = header["dataWindow"], header["displayWindow"]
    if np.array_equal(data, display):
        return values
    width, height = _window_size(display)
    left, top = (int(a) - int(b) for a, b in zip(data[0], display[0], strict=True))
    frame = np.full((height, width), np.nan, np.float32)
    rows = np.arange(max(top, 0), min(top + values.shape[0], height))
    columns = np.arange(max(left, 0), min(left + values.shape[1], width))
    frame[np.ix_(rows, columns)] = values[np.ix_(rows - top, columns - left)]
    return frame


class _OtherThreads:
    """Standard output that drops what one thread writes."""

    def __init__(self, output: TextIO) -> None:
        self._output, self._thread = output, threading.get_ident()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever else a stream has
        return getattr(self._output, name)

    def write(self, text: str) -> int:
        """Pass on what other threads write."""
        return len(text) if threading.get_ident() == self._thread else self._output.write(text)


@contextmanager
def _silenced() -> Iterator[None]:
    """Keep OpenEXR from printing to standard output and error."""
    others = cast("TextIO", _OtherThreads(sys.stdout))
    with _LOCK, decoder_messages(), redirect_stdout(others):
        yield


@contextmanager
def _utf8_name(path: Path) -> Iterator[str]:
    """A UTF-8 name of the same file, because OpenEXR accepts no others."""
    if isinstance(path, RemotePath):
        with local_copy(path) as copy:
            yield str(copy)
        return
    name = os.fspath(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        with temporary_folder() as folder:
            link = folder / "depth.exr"
            link.symlink_to(path.absolute())
            yield str(link)
    else:
        yield name
