"""Reading files whole: only such as have an end, and not more than their reader can use."""

import errno
import stat
from pathlib import Path

from depthcli.io.storage.remote import RemotePath


def read_regular(path: Path, max_bytes: int, *, first: int = -1) -> bytes:
    """Content of a regular file, or its first so many bytes.

    Raises:
        OSError: it cannot be read, is no regular file, is larger than ``max_bytes``, or grows.
    """
    if isinstance(path, RemotePath):
        return path.read_some(max_bytes, first=first)
    size = regular_size(path)
    if size > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", path)
    if not size:
        return b""
    # Python sets aside as many bytes as it is asked for, so it is not asked for ``max_bytes``.
    with path.open("rb") as file:
        content = file.read(size + 1 if first < 0 else min(first, size))
    if len(content) > size:
        raise OSError(errno.EAGAIN, "it grew while it was read; try again", path)
    return content


def regular_size(path: Path) -> int:
    """Bytes of a regular file.

    Pipes and devices may never end, and so may what the system only calls a file, such as
    ``/proc/kmsg``; those state no size.

    Raises:
        OSError: it is not there, or is no regular file.
    """
    try:
        status = path.stat()
    except ValueError as error:  # a NUL byte, or what no file system can hold
        raise OSError(errno.EINVAL, f"no file has such a name ({error})", path) from None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", path)
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device; copy it to a file", path)
    return status.st_size
