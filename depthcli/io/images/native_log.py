"""Capturing the messages of decoders about damaged files, which OpenCV does not return.

libjpeg and libpng write to C's ``stderr``, OpenCV writes libtiff's messages to C++'s ``cerr``. In
glibc ``stderr`` is a variable, and libstdc++'s ``cerr`` holds a copy of it, so during a decoder's
call both are redirected; Python's own standard error is not touched. On other systems OpenCV is
silenced, and the other libraries print as usual.
"""

from __future__ import annotations

import ctypes
import os
import platform
import threading
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

import cv2

if TYPE_CHECKING:
    from collections.abc import Iterator

SILENT, WARNINGS = 0, 3


def set_log_level(level: int) -> int:
    """Set OpenCV's log level, for all threads; return the level before."""
    log = getattr(cv2.utils, "logging", cv2)  # OpenCV 4 has these in cv2 itself
    before: int = log.getLogLevel()
    log.setLogLevel(level)
    return before


@contextmanager
def silent_opencv() -> Iterator[None]:
    """Keep OpenCV silent, in all threads at once."""
    level = set_log_level(SILENT)
    try:
        yield
    finally:
        set_log_level(level)


_OPENCV = (b"[ WARN:", b"[ERROR:")
_POINTER_BYTES = ctypes.sizeof(ctypes.c_void_p)
_BASE_OFFSET = 3 * _POINTER_BYTES
"""Bytes before an ostream's vtable to the offset of its basic_ios (Itanium C++ ABI)."""
_STREAM_OFFSET = 8 * _POINTER_BYTES
"""Of the FILE pointer in a stdio_sync_filebuf: after its vtable, six pointers and a locale."""
_UNBUFFERED = 2
_STDERR_FD = 2
_WRITE = ctypes.CFUNCTYPE(
    ctypes.c_ssize_t, ctypes.c_void_p, ctypes.POINTER(ctypes.c_char), ctypes.c_size_t
)


class _CookieFunctions(ctypes.Structure):
    """cookie_io_functions_t of fopencookie(3)."""

    _fields_ = (
        ("read", ctypes.c_void_p),
        ("write", _WRITE),
        ("seek", ctypes.c_void_p),
        ("close", ctypes.c_void_p),
    )


class _Stderr:
    """Standard error of C and C++, which is captured separately for each thread."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None)
        variable = ctypes.c_void_p.in_dll(libc, "stderr")
        self._original = variable.value
        cerr = _cerr_stream(self._original)
        self._variables = [variable] if cerr is None else [variable, cerr]
        self._level = SILENT if cerr is None else WARNINGS
        self._original_level = SILENT
        self._write = _WRITE(self._on_write)  # C keeps no reference to it
        libc.fopencookie.restype = ctypes.c_void_p
        libc.fopencookie.argtypes = (ctypes.c_void_p, ctypes.c_char_p, _CookieFunctions)
        libc.setvbuf.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t)
        self._stream = libc.fopencookie(None, b"w", _CookieFunctions(write=self._write))
        libc.setvbuf(self._stream, None, _UNBUFFERED, 0)
        self._lock = threading.Lock()
        self._captures = 0
        self._captured = threading.local()

    @contextmanager
    def capture(self, captured: bytearray) -> Iterator[None]:
        """Append what this thread's C code writes to a buffer."""
        self._captured.text = captured
        self._count(1)
        try:
            yield
        finally:
            self._count(-1)
            self._captured.text = None

    def _count(self, change: int) -> None:
        with self._lock:
            was_capturing = self._captures > 0
            self._captures += change
            if was_capturing == (self._captures > 0):
                return
            if was_capturing:
                set_log_level(self._original_level)
            for variable in self._variables:
                variable.value = self._original if was_capturing else self._stream
            if not was_capturing:
                self._original_level = set_log_level(self._level)

    def _on_write(self, _cookie: int, text: ctypes._Pointer[ctypes.c_char], size: int) -> int:
        data = ctypes.string_at(text, size)
        captured = getattr(self._captured, "text", None)
        if captured is None:  # written by a thread that decodes no picture
            return size if data.startswith(_OPENCV) else os.write(_STDERR_FD, data)
        captured += data
        return size


def _cerr_stream(original: int | None) -> ctypes.c_void_p | None:
    """The FILE pointer inside libstdc++'s ``cerr``; None if it is not found."""
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
    return stream if stream.value == original else None


@cache
def _stderr() -> _Stderr | None:
    return _Stderr() if platform.libc_ver()[0] == "glibc" else None


@contextmanager
def decoder_messages() -> Iterator[bytearray]:
    """Capture what decoders print in this thread.

    Yields:
        The text, complete when the block ends; empty where standard error cannot be redirected.
    """
    captured = bytearray()
    stderr = _stderr()
    if stderr is None:
        with silent_opencv():
            yield captured
        return
    with stderr.capture(captured):
        yield captured
