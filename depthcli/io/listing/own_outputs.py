"""Recognizing outputs of depthcli among its inputs."""

import os
import re
from pathlib import Path

from depthcli.errors import OutputError
from depthcli.io.formats.table import Format, is_own, read_head
from depthcli.io.images.png import SIGNATURE
from depthcli.io.storage.remote import RemotePath, path_of

EXR_MAGIC = b"v/1\x01"
"""The first bytes of every EXR."""
_IMAGES = (".png", ".exr")
_SUFFIXES = (*_IMAGES, ".ply", ".json")
_MAGIC = (SIGNATURE, EXR_MAGIC, b"ply")
_PICTURE_NAME = r"(?i)(\.(depth(\.\d{6,})?|preview)\.png|depth[^/]*\.exr)$"
_VIDEO_NAME = r"(?i)\.(depth\.mkv|preview\.(mp4|webm|mov))$"


def is_own_picture(path: str | Path) -> bool:
    """Whether a file is a PNG or an EXR that depthcli wrote; in a store, by its name first."""
    path = path_of(path)
    if isinstance(path, RemotePath) and not re.search(_PICTURE_NAME, path.name):
        return False  # saves a request for each input
    try:
        return path.suffix.lower() in _IMAGES and is_own(path)
    except OSError:
        return False


def check_replaceable(path: Path) -> None:
    """Check that no PNG, EXR, PLY or JSON that depthcli did not write is replaced by an output.

    That may be a plate, the depth of a sensor, a scan or a calibration. In an object store, it
    takes one request.

    Raises:
        OutputError: it does, or the store does not answer.
    """
    if path.suffix.lower() not in _SUFFIXES:
        return
    head = replaced_head(path)
    # Any text may be JSON: there are comments, and other encodings.
    is_foreign = head if path.suffix.lower() == ".json" else head.startswith(_MAGIC)
    if is_foreign and not is_own(path):
        raise foreign_error(path)


def replaced_head(path: Path) -> bytes:
    """First bytes of the file that an output would replace; empty if it cannot be read.

    Raises:
        OutputError: a store does not answer, or the file may not be read.
    """
    is_remote = isinstance(path, RemotePath)
    try:
        return read_head(path)
    except FileNotFoundError:
        return b""
    except PermissionError as error:
        if is_remote or not os.path.isfile(path):  # noqa: PTH113 - never raises
            return b""  # without the right to list, S3 answers 403 for missing objects
        raise OutputError(
            f"{path} may not be read, so it may be another program's; choose another output"
        ) from error
    except OSError as error:
        if is_remote:
            raise OutputError(f"cannot write {path}: {error.strerror}") from error
        return b""  # writing it tells why


def foreign_error(path: Path) -> OutputError:
    """That an output would replace a file of another program."""
    return OutputError(
        f"{path} exists and was not written by depthcli; choose another output, or move it away"
    )


def is_own_exr(data: bytes) -> bool:
    """Whether an EXR, of which the first bytes are enough, was written by depthcli."""
    return Format.EXR.facts.mark in data[:4096]


def is_own_output(path: str) -> bool:
    """Whether a file found in a folder is an output of depthcli.

    Videos are recognized by their names alone; pictures are opened only if their names match.
    """
    if re.search(_VIDEO_NAME, path):
        return True
    return re.search(_PICTURE_NAME, path) is not None and is_own_picture(path)
