"""Recognizing depth videos that depthcli wrote among its outputs."""

import sys
from pathlib import Path

from depthcli.errors import OutputError
from depthcli.io.storage.regular import read_regular
from depthcli.io.storage.remote import RemotePath
from depthcli.video.depth import LABEL_PREFIX
from depthcli.video.integrity import EBML

_HEAD_BYTES = 4096  # the labels follow the description of the stream


def check_replaceable_video(path: Path) -> None:
    """Check that a depth video does not take the place of a Matroska that depthcli did not write.

    As for PNG and EXR, what is not in that format is replaced. Previews have no labels by which
    they could be recognized.

    Raises:
        OutputError: it does, or the store does not answer.
    """
    try:
        head = read_regular(path, sys.maxsize, first=_HEAD_BYTES)
    except (FileNotFoundError, PermissionError):
        return  # without the right to list, S3 answers 403 for missing objects
    except OSError as error:
        if isinstance(path, RemotePath):
            raise OutputError(f"cannot write {path}: {error.strerror}") from error
        return  # writing it tells why
    if head.startswith(EBML) and LABEL_PREFIX.encode() not in head:
        raise OutputError(
            f"{path} exists and was not written by depthcli; remove it or choose another output"
        )
