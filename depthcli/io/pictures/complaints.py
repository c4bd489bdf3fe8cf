"""What libjpeg and libpng print of damaged files, which OpenCV neither passes on nor keeps silent.

Both write to C's ``stderr``. With glibc that is a variable, so for the time of a decoder's call it
leads here instead; Python's own standard error is not touched. Elsewhere they print as ever.
"""

from __future__ import annotations

import ctypes
import os
import platform
import threading
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

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
    """C's ``stderr``, led to whoever listens in the thread that writes."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None)
        self._variable = ctypes.c_void_p.in_dll(libc, "stderr")
        self._usual = self._variable.value
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
            self._listeners += change
            self._variable.value = self._ours if self._listeners else self._usual

    def _take(self, _cookie: int, text: ctypes._Pointer[ctypes.c_char], size: int) -> int:
        data = ctypes.string_at(text, size)
        heard = getattr(self._heard, "text", None)
        if heard is None:  # another thread's, which has nothing to do with pictures
            return os.write(_STDERR_FD, data)
        heard += data
        return size


@cache
def _stderr() -> _Stderr | None:
    return _Stderr() if platform.libc_ver()[0] == "glibc" else None


@contextmanager
def complaints() -> Iterator[bytearray]:
    """What decoders print in this thread, complete when the block ends.

    Yields:
        The text, empty at first; it stays empty where C's ``stderr`` cannot be led elsewhere.
    """
    heard = bytearray()
    stderr = _stderr()
    if stderr is None:
        yield heard
        return
    with stderr.led_to(heard):
        yield heard
