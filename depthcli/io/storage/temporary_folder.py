"""Temporary folders, for libraries that want files where there are to be none."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from depthcli.core.ending import before_ending
from depthcli.errors import OutputError


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder away from the outputs, which is gone when the block ends, or the process.

    Raises:
        OutputError: there is no place for one.
    """
    from tempfile import TemporaryDirectory  # noqa: PLC0415 - 2 ms, and seldom used

    try:
        folder = TemporaryDirectory(prefix="depthcli-")
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write a temporary file: {reason}; set TMPDIR") from error
    with before_ending(folder.cleanup), folder as name:
        yield Path(name)
