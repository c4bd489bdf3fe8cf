"""Reading regular files, up to a limit of size."""

import errno
import stat
from pathlib import Path

from depthcli.io.storage.remote import RemotePath


def read_regular(path: Path, max_bytes: int, *, first: int = -1) -> bytes:
    """Content of a regular file, or its ``first`` bytes.

    Raises:
        OSError: it cannot be read, is not a regular file, is larger than ``max_bytes``, or grows.
    """
    if isinstance(path, RemotePath):
        return path.read_some(max_bytes, first=first)
    size = regular_size(path)
    if size > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", path)
    if not size:
        return b""
    # Python allocates as many bytes as are requested, so ``max_bytes`` are not.
    with path.open("rb") as file:
        content = file.read(size + 1 if first < 0 else min(first, size))
    if len(content) > size:
        raise OSError(errno.EAGAIN, "it grew while it was read; try again", path)
    return content


def regular_size(path: Path) -> int:
    """Size of a regular file in bytes.

    Pipes and devices may never end, nor may some special files such as ``/proc/kmsg``, whose size
    is 0.

    Raises:
        OSError: it is missing, or is not a regular file.
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
