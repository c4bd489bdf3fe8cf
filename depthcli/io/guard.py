"""Files that depthcli wrote: how they are recognized, and that no others are replaced."""

import os
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Self

from depthcli.errors import OutputError
from depthcli.io.formats.table import FORMATS, suffix_of
from depthcli.io.media import COMMENT_PREFIX, LABEL_PREFIX
from depthcli.io.storage.atomic import OUT_ADVICE, FileIdentity, identity_of
from depthcli.io.storage.paths import RemotePath, path_of, read_regular

_HEAD_BYTES = 4096
_WEBM_HEAD_BYTES = 2**16  # tags come after the headers of audio, of which Vorbis' are long
_DEFAULT_STEM = re.compile(r"(?i)\.depth(\.\d+)?$", re.ASCII)
_IMAGES = (".png", ".exr", ".tif", ".tiff", ".pgm")
_VIDEOS = (".mkv", ".mp4", ".webm", ".mov")
_MARKS = {PurePath(f"a{facts.suffix}").suffix: facts.mark for facts in FORMATS.values()}
_MARKS |= dict.fromkeys(_VIDEOS, COMMENT_PREFIX.encode())  # of colours
_MARKS[".mkv"] = LABEL_PREFIX.encode()  # of depth


def is_own(path: Path) -> bool:
    """Whether depthcli wrote a file that exists.

    Its first bytes have the mark of its format; in a format without marks, it has a default name,
    such as ``a.depth.npy`` or ``a.depth.000001.npy``.

    Raises:
        OSError: it cannot be read, or is not a regular file.
    """
    end = suffix_of(path)
    mark = _MARKS.get(end)
    if mark:
        read = partial(read_regular, path, sys.maxsize)
        head = read(first=_WEBM_HEAD_BYTES if end == ".webm" else _HEAD_BYTES)
        return mark in (read(first=_index_end(head)) if end in {".mp4", ".mov"} else head)
    return mark is not None and _DEFAULT_STEM.search(path.stem) is not None


def _index_end(head: bytes) -> int:
    """Where the index of an MP4 or MOV ends, if it follows the first box; else a few kilobytes.

    Its last box has the comment, behind tables that are as long as the video.
    """
    start = int.from_bytes(head[:4])
    is_index = head[start + 4 : start + 8] == b"moov"
    return start + int.from_bytes(head[start : start + 4]) if is_index else _HEAD_BYTES


_IMAGE_NAME = r"(?i)depth|normals|preview|stereo|error"  # words of default names
_OTHER_NAME = r"(?i)\.(depth\.(mkv|tar|parquet|mcap|db3)|stereo\.mp4|preview\.(mp4|webm|mov))$"


def is_own_image(path: str | Path, suffixes: tuple[str, ...] = _IMAGES) -> bool:
    """Whether a file of such a suffix is one that depthcli wrote; in a store, by its name first."""
    path = path_of(path)
    if isinstance(path, RemotePath) and not re.search(_IMAGE_NAME, path.name):
        return False  # saves a request for each input
    try:
        return path.suffix.lower() in suffixes and is_own(path)
    except OSError:
        return False


def is_own_output(path: str) -> bool:
    """Whether an image or a video is one that depthcli wrote, which is no input of another."""
    return bool(re.search(_OTHER_NAME, path)) or is_own_image(path, _IMAGES + _VIDEOS)


@dataclass(frozen=True, slots=True)
class Guard:
    """An existing file is replaced only if depthcli wrote it, or on request; an input never.

    A file without content has nothing to lose, and is replaced as well.
    """

    inputs: frozenset[FileIdentity] = frozenset()  #: files that are never replaced
    overwrite: bool = False  #: whether files of other programs may be replaced

    @classmethod
    def of(cls, inputs: Iterable[Path], *, overwrite: bool = False) -> Self:
        """Make a guard of inputs, which are looked up now."""
        return cls(frozenset(map(identity_of, inputs)), overwrite)

    def check(self, *paths: Path) -> None:
        """Check that outputs may be written to paths; one request each in an object store."""
        for path in paths:
            if self.inputs and identity_of(path) in self.inputs:
                raise OutputError(f"{path} is an input and is not replaced", OUT_ADVICE)
            if not self.overwrite and self._is_foreign(path):
                problem = f"{path} exists and does not state that depthcli wrote it"
                raise OutputError(problem, f"{OUT_ADVICE}, or replace it with {{overwrite}}")

    def _is_foreign(self, path: Path) -> bool:
        is_remote = isinstance(path, RemotePath)
        try:
            if (not is_remote and not path.stat().st_size) or is_own(path):
                return False
            return not is_remote or path.exists()  # a name may have told without a request
        except FileNotFoundError:
            return False
        except PermissionError:
            # Without the right to list, S3 answers 403 for missing objects.
            return not is_remote and os.path.isfile(path)  # noqa: PTH113 - never raises
        except (OSError, ValueError) as error:
            if not is_remote:
                return False  # a folder or an impossible name: writing it tells why
            raise OutputError(f"cannot write {path}: {error}") from error
