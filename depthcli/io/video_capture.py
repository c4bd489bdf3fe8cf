"""Opening a video with OpenCV's FFmpeg, with one clear line if that fails."""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING

import cv2

from depthcli.errors import InputError
from depthcli.io.ffmpeg_log import silent_ffmpeg

if TYPE_CHECKING:
    from pathlib import Path


def open_capture(path: Path) -> cv2.VideoCapture:
    """A video, ready for its first frame.

    Raises:
        InputError: missing, empty, unreadable, or without a video stream that can be decoded.
    """
    _check_file(path)
    # An absolute name cannot be taken for a protocol of FFmpeg's.
    name = os.path.abspath(path)  # noqa: PTH100 - links stay as named
    try:
        name.encode()
        with silent_ffmpeg():
            capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
    except UnicodeEncodeError:
        raise InputError(f"{path} has a name that is not UTF-8; rename it") from None
    except cv2.error:
        capture = cv2.VideoCapture()
    if not capture.isOpened():
        raise InputError(
            f"{path} holds no video that can be read: damaged, cut off, without a video stream, "
            "or of a codec that FFmpeg does not have here"
        )
    return capture


def _check_file(path: Path) -> None:
    """Say what is wrong with a file before FFmpeg says less."""
    try:
        if not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():
            raise InputError(f"{path} is a pipe or a device; save the video to a file first")
        with path.open("rb") as file:
            empty = not file.read(1)
    except FileNotFoundError:
        what = "is a broken link" if path.is_symlink() else "is missing: no such file"
        raise InputError(f"{path} {what}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder; name a video in it") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    if empty:
        raise InputError(f"{path} is empty")
