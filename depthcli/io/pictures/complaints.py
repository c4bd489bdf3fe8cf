"""What decoders print of damaged files, which OpenCV does not pass on.

libjpeg and libpng write to C's ``stderr``, OpenCV what libtiff says to C++'s ``cerr``. With glibc
the one is a variable, and with libstdc++ the other holds a copy of it, so for the time of a
decoder's call both lead here instead; Python's own standard error is not touched. Elsewhere OpenCV
is silent, and the others print as ever.
"""

from __future__ import annotations

import ctypes
import os
import platform
import threading
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from depthcli.io.opencv_log import SILENT, WARNINGS, set_log_level, silent_opencv

if TYPE_CHECKING:
    from collections.abc import Iterator

_OPENCV = (b"[ WARN:", b"[ERROR:")
_POINTER_BYTES = ctypes.sizeof(ctypes.c_void_p)
_BASE_OFFSET = 3 * _POINTER_BYTES
"""Before an ostream's table of functions: how far after it its basic_ios is (Itanium C++ ABI)."""
_STREAM_OFFSET = 8 * _POINTER_BYTES
"""In a stdio_sync_filebuf: after its table, six pointers and a locale."""
_UNBUFFERED = 2
_STDERR_FD = 2
_WRITE = ctypes.CFUNCTYPE(
    ctypes.c_ssize_t, ctypes.c_void_p, ctypes.POINTER(ctypes.c_char), ctypes.c_size_t
)


class _Cookie(ctypes.Structure):
    """cookie_io_functions_t of fopencookie(3)."""

    _fields_ = (
        ("read", ctypes.c_void_p),
        ("write", _WRITE),
        ("seek", ctypes.c_void_p),
        ("close", ctypes.c_void_p),
    )


class _Stderr:
    """Standard error of C and C++, redirected to whoever listens in the thread that writes."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None)
        variable = ctypes.c_void_p.in_dll(libc, "stderr")
        self._usual = variable.value
        cerr = _stream_of_cerr(self._usual)
        self._variables = [variable] if cerr is None else [variable, cerr]
        self._level = SILENT if cerr is None else WARNINGS
        self._usual_level = SILENT
        self._write = _WRITE(self._take)  # C keeps no reference to it
        libc.fopencookie.restype = ctypes.c_void_p
        libc.fopencookie.argtypes = (ctypes.c_void_p, ctypes.c_char_p, _Cookie)
        libc.setvbuf.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t)
        self._ours = libc.fopencookie(None, b"w", _Cookie(write=self._write))
        libc.setvbuf(self._ours, None, _UNBUFFERED, 0)
        self._lock = threading.Lock()
        self._listeners = 0
        self._heard = threading.local()

    @contextmanager
    def led_to(self, heard: bytearray) -> Iterator[None]:
        """Append what this thread's C code writes."""
        self._heard.text = heard
        self._count(1)
        try:
            yield
        finally:
            self._count(-1)
            self._heard.text = None

    def _count(self, change: int) -> None:
        with self._lock:
            was_heard = self._listeners > 0
            self._listeners += change
            if was_heard == (self._listeners > 0):
                return
            if was_heard:
                set_log_level(self._usual_level)
            for variable in self._variables:
                variable.value = self._usual if was_heard else self._ours
            if not was_heard:
                self._usual_level = set_log_level(self._level)

    def _take(self, _cookie: int, text: ctypes._Pointer[ctypes.c_char], size: int) -> int:
        data = ctypes.string_at(text, size)
        heard = getattr(self._heard, "text", None)
        if heard is None:  # another thread's, which has nothing to do with pictures
            return size if data.startswith(_OPENCV) else os.write(_STDERR_FD, data)
        heard += data
        return size


def _stream_of_cerr(usual: int | None) -> ctypes.c_void_p | None:
    """Where libstdc++'s ``cerr`` keeps the C stream that it writes to; None if it is not there."""
    try:
        cpp = ctypes.CDLL("libstdc++.so.6")
        cerr = ctypes.addressof(ctypes.c_char.in_dll(cpp, "_ZSt4cerr"))
        buffer_of = cpp["_ZNKSt9basic_iosIcSt11char_traitsIcEE5rdbufEv"]
    except (OSError, ValueError, AttributeError):
        return None
    buffer_of.argtypes, buffer_of.restype = (ctypes.c_void_p,), ctypes.c_void_p
    table = ctypes.c_void_p.from_address(cerr).value or 0
    base = ctypes.c_ssize_t.from_address(table - _BASE_OFFSET).value
    stream = ctypes.c_void_p.from_address(buffer_of(cerr + base) + _STREAM_OFFSET)
    return stream if stream.value == usual else None


@cache
def _stderr() -> _Stderr | None:
    return _Stderr() if platform.libc_ver()[0] == "glibc" else None


@contextmanager
def complaints() -> Iterator[bytearray]:
    """What decoders print in this thread, complete when the block ends.

    Yields:
        The text, empty at first; it stays empty where standard error cannot be redirected.
    """
    heard = bytearray()
    stderr = _stderr()
    if stderr is None:
        with silent_opencv():
            yield heard
        return
    with stderr.led_to(heard):
        yield heard
