"""Temporary folders, for libraries that need a local file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from depthcli.core.exit_hooks import exit_hook
from depthcli.errors import OutputError


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder in the system's temporary one, removed when the block or the process ends.

    Raises:
        OutputError: it cannot be created.
    """
    from tempfile import TemporaryDirectory  # noqa: PLC0415 - 2 ms, and seldom used

    try:
        folder = TemporaryDirectory(prefix="depthcli-")
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write a temporary file: {reason}; set TMPDIR") from error
    with exit_hook(folder.cleanup), folder as name:
        yield Path(name)
