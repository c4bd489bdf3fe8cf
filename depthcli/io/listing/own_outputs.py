"""Recognizing outputs of depthcli among its inputs."""

import re
from pathlib import Path

from depthcli.io.formats.table import Format, is_own
from depthcli.io.storage.paths import RemotePath, path_of

EXR_MAGIC = b"v/1\x01"
"""The first bytes of every EXR."""
_IMAGES = (".png", ".exr")
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
