"""How files are recognized: suffixes, the packages they need, marks that depthcli writes."""

import os
from functools import cache
from importlib.util import find_spec

from depthcli.core.options import INSTALL_FORMATS, INSTALL_HEIF

EXR_MAGIC = b"v/1\x01"  #: the first bytes of every EXR
IMAGE_SUFFIXES = (
    *(".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".webp", ".avif"),
    *(".bmp", ".dib", ".gif", ".pbm", ".pgm", ".ppm", ".pnm"),
)
EXR_SUFFIX = ".exr"  #: not among ``IMAGE_SUFFIXES``: most such files in a folder hold no image
VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg"),
    *(".mts", ".m2ts", ".ts", ".mxf", ".wmv", ".flv", ".ogv", ".3gp"),
)
BAG_SUFFIXES = (".mcap", ".db3")  #: of ROS 2
ARCHIVE_SUFFIXES = (".tar", ".parquet", *BAG_SUFFIXES)
CAMERA_RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf")
HEIF_SUFFIXES = (".heic", ".heif", ".hif")
FORMATS_SUFFIXES = (".dpx", ".cin", ".hdr", ".psd", ".jxl", ".jp2", ".tga")
EXTRAS = {  #: the package that images of a suffix need, and how to install it
    **dict.fromkeys(HEIF_SUFFIXES, ("pillow_heif", INSTALL_HEIF)),
    **dict.fromkeys(FORMATS_SUFFIXES, ("OpenImageIO", INSTALL_FORMATS)),
}


@cache
def is_installed(package: str) -> bool:
    """Whether an extra's package is installed; it is not loaded."""
    return find_spec(package) is not None


def lower_suffix(name: str) -> str:
    """The suffix of a name in lower case."""
    return os.path.splitext(name)[1].lower()  # noqa: PTH122 - names, not paths


def is_video(name: str) -> bool:
    """Whether a name's suffix is a video's."""
    return lower_suffix(name) in VIDEO_SUFFIXES


def is_archive(name: str) -> bool:
    """Whether a name's suffix is that of images in one file: a tar shard, Parquet or a bag."""
    return lower_suffix(name) in ARCHIVE_SUFFIXES


def is_bag(name: str) -> bool:
    """Whether a name's suffix is that of a bag of ROS 2, MCAP or SQLite."""
    return lower_suffix(name) in BAG_SUFFIXES


def is_exr(name: str) -> bool:
    """Whether a name's suffix is that of OpenEXR, which holds images or depth."""
    return lower_suffix(name) == EXR_SUFFIX


def is_image(name: str) -> bool:
    """Whether a name's suffix is that of an image that is read here, EXR apart."""
    suffix = lower_suffix(name)
    return suffix in IMAGE_SUFFIXES or (suffix in EXTRAS and is_installed(EXTRAS[suffix][0]))


def is_media(name: str) -> bool:
    """Whether a name is an image's or a video's by its suffix, and not hidden."""
    return not name.startswith(".") and (is_image(name) or is_video(name))


KEY_PREFIX = "depthcli:"  #: start of the names of texts in PNG, EXR and PLY
SOFTWARE_KEY = f"{KEY_PREFIX}software"  #: a text in every PNG (after its header) and EXR
LABEL_PREFIX = "DEPTHCLI_"  #: start of the names of the labels in a depth video
COMMENT_PREFIX = "written by depthcli "  #: start of the comment in a preview or stereo video
EXR_MARK = f"{SOFTWARE_KEY}\0string\0".encode()  #: within the first 4,096 bytes of an EXR
