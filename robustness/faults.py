"""Commands of which one system call fails, each in a process forked from one that has it loaded."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

CALLS = ("open", "write", "fsync", "rename", "mkdir", "read")
ERRORS = {
    "open": (errno.ENOSPC, errno.EIO, errno.EMFILE, errno.EACCES),
    "write": (errno.ENOSPC, errno.EIO),
    "fsync": (errno.ENOSPC, errno.EIO),
    "rename": (errno.ENOSPC, errno.EIO, errno.EACCES),
    "mkdir": (errno.ENOSPC, errno.EIO, errno.EACCES),
    "read": (errno.EIO,),
}
"""What the manual pages of the calls have them fail with."""
LASTING = {("write", errno.ENOSPC), ("open", errno.EACCES), ("read", errno.EIO)}
"""A full disk, a folder that became read-only and a mount that is gone go on failing."""
NAMES = tuple(sorted({errno.errorcode[error] for some in ERRORS.values() for error in some}))
HANGS_S = 120


class Fault(NamedTuple):
    """One call that fails, and with ``onwards`` all of its kind after it."""

    call: str
    number: int
    error: int
    onwards: bool = False

    def __str__(self) -> str:
        ways = " and all after it" if self.onwards else ""
        return f"{self.call} {self.number}{ways}: {errno.errorcode[self.error]}"


class Ended(NamedTuple):
    """How a command ended."""

    code: int | None  #: its exit code; negative for a signal, None if it hung
    err: str  #: what it wrote to standard error
    counts: dict[str, int]  #: how many calls of each kind it made
    where: str  #: the path of the call that failed; "" if none did


class Call(NamedTuple):
    """One call of a run without faults."""

    kind: str
    number: int  #: among those of its kind, from 1
    place: str  #: a hash of the lines of Python that it was made from, and of its file's suffix


class _Shared(ctypes.Structure):
    _fields_ = (("count", ctypes.c_long * len(CALLS)), ("where", ctypes.c_char * 256))


def library(folder: Path) -> Path | None:
    """The compiled ``faults.c``; None without a C compiler, or where there is no LD_PRELOAD."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        return None
    target = folder / "faults.so"
    source = Path(__file__).with_name("faults.c")
    command = [compiler, "-O1", "-shared", "-fPIC", "-U_FORTIFY_SOURCE", "-o", target, source]
    subprocess.run([*command, "-ldl"], check=True)
    return target


_LISTENER = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.c_char_p)


def _stack() -> Iterator[str]:
    """Lines of Python that this thread is in, but for those of the listener."""
    frame = sys._getframe(2)  # the traceback module would read files
    while frame is not None:
        yield f"{frame.f_code.co_filename}:{frame.f_lineno}"
        frame = frame.f_back


class Injector:
    """Runs commands; this process was started with the library preloaded."""

    def __init__(self, path: Path, environment: dict[str, str]) -> None:
        self._library = ctypes.CDLL(str(path))
        self._library.faults_shared.restype = ctypes.POINTER(_Shared)
        self._shared = self._library.faults_shared().contents
        self._environment = environment

    def run(
        self,
        words: tuple[str, ...],
        folder: Path,
        fault: Fault | None = None,
        log: Path | None = None,
    ) -> Ended:
        """A command in a folder, to its end; with ``log``, its calls are written there."""
        streams = [folder.with_name(f"{folder.name}.{name}") for name in ("out", "err")]
        child = os.fork()
        if not child:
            if log is not None:
                self._listen(log)
            self._become(words, folder, fault, streams)
        code = exit_code(child)
        err = streams[1].read_text("utf-8", "replace")
        counts = dict(zip(CALLS, self._shared.count, strict=True))
        return Ended(code, err, counts, self._shared.where.decode())

    def calls(self, words: tuple[str, ...], folder: Path) -> tuple[Ended, list[Call]]:
        """A command without a fault, with each call that it made."""
        log = folder.with_name(f"{folder.name}.calls")
        log.unlink(missing_ok=True)
        done = self.run(words, folder, log=log)
        counts: Counter[str] = Counter()
        calls = []
        for line in log.read_text().splitlines():
            kind, place = line.split()
            counts[kind] += 1
            calls.append(Call(kind, counts[kind], place))
        return done, calls

    def _become(
        self, words: tuple[str, ...], folder: Path, fault: Fault | None, streams: list[Path]
    ) -> None:
        """Be the command, in a process of its own."""
        code = 70
        try:
            os.chdir(folder)
            for handle, path in enumerate(streams, start=1):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666), handle)
            os.environ.update(
                {name: word.format(folder) for name, word in self._environment.items()}
            )
            sys.argv = ["depthcli", *words]
            self._arm(folder, fault)
            from depthcli.cli.app import main  # noqa: PLC0415 - loaded before the fork

            code = main()
            sys.stdout.flush()
        finally:
            sys.stderr.flush()
            os._exit(code)

    def _listen(self, log: Path) -> None:
        """From now on write down each call, and where the code is that makes it."""
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)

        def heard(kind: int, path: bytes) -> None:
            place = " ".join((Path(os.fsdecode(path)).suffix, *_stack()))
            os.write(handle, f"{CALLS[kind]} {sha256(place.encode()).hexdigest()}\n".encode())

        self._listener = _LISTENER(heard)  # which has to live as long as the process
        self._library.faults_tell(self._listener)

    def _arm(self, folder: Path, fault: Fault | None) -> None:
        fault = fault or Fault("open", 0, 0)
        self._library.faults_arm(
            os.fsencode(folder),
            CALLS.index(fault.call) if fault.number else -1,
            ctypes.c_long(fault.number),
            fault.error,
            fault.onwards,
        )


def exit_code(process: int, longest_s: float = HANGS_S) -> int | None:
    """How a process ended, negative for a signal; None for one that had to be killed."""
    until_s = time.monotonic() + longest_s
    while time.monotonic() < until_s:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return None
