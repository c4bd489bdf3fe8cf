"""Calling OpenEXR: paths of any bytes, silence, the kinds of its errors and of its rates."""

import os
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from fractions import Fraction
from pathlib import Path
from typing import Any, TextIO, cast

from depthcli.io.pictures.decoder_messages import decoder_messages
from depthcli.io.storage.remote import RemotePath
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.io.storage.transfer import local_copy

OPENEXR_ERRORS = (RuntimeError, ValueError, TypeError, OSError, MemoryError, ArithmeticError)
_LOCK = threading.Lock()  # standard output is redirected meanwhile


class _OtherThreads:
    """Standard output that drops what one thread writes."""

    def __init__(self, output: TextIO) -> None:
        self._output, self._thread = output, threading.get_ident()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever else a stream has
        return getattr(self._output, name)

    def write(self, text: str) -> int:
        """Pass on what other threads write."""
        return len(text) if threading.get_ident() == self._thread else self._output.write(text)


@contextmanager
def silenced() -> Iterator[None]:
    """Keep OpenEXR from printing to standard output and error."""
    others = cast("TextIO", _OtherThreads(sys.stdout))
    with _LOCK, decoder_messages(), redirect_stdout(others):
        yield


@contextmanager
def utf8_name(path: Path) -> Iterator[str]:
    """A UTF-8 name of the same file, because OpenEXR accepts no others."""
    if isinstance(path, RemotePath):
        with local_copy(path) as copy:
            yield str(copy)
        return
    name = os.fspath(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        with temporary_folder() as folder:
            link = folder / "depth.exr"
            link.symlink_to(path.absolute())
            yield str(link)
    else:
        yield name


def stated_rate(header: Mapping[str, Any]) -> Fraction | None:
    """Frames a second that a header states; None if it does not, or not above 0."""
    stated = header.get("framesPerSecond")
    if not isinstance(stated, Fraction):  # releases of OpenEXR differ
        d = getattr(stated, "d", None)
        stated = Fraction(stated.n, d) if stated is not None and d else None
    return stated if stated and stated > 0 else None
