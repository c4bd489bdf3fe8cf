"""Where the rows of a batch are written: in its output folder, or here for a remote one."""

import os
import re
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from depthcli.errors import OutputError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.remote import RemotePath
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.io.storage.transfer import download

_SEND_EVERY_S = 5.0
_BEGINNINGS = (".depthcli-batch", "manifest")
_PART = re.compile(r"\.\d{20}-[0-9a-f]{8}$")


class RowsFolder:
    """The output folder itself."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def keep(self) -> None:
        """See to it that rows outlast this machine; the disk does."""

    def finish(self) -> None:
        """Put the manifest in place, where it is already."""


class RemoteRows(RowsFolder):
    """A copy of what rows a remote folder has, for as long as a batch takes.

    Objects are not appended to: what the journal gets is sent now and then as a part of its own,
    so that the next batch, on whatever machine, finds all but the last rows of one that was killed.
    """

    def __init__(self, out: RemotePath) -> None:
        """Fetch the rows that are there.

        Raises:
            OutputError: the folder cannot be read.
        """
        self._out, self._lock, self._sent_s = out, threading.Lock(), time.monotonic()
        self._ending = ExitStack()
        super().__init__(self._ending.enter_context(temporary_folder()))
        self._objects: dict[str, list[str]] = {}  # of each file here
        try:
            for name in self._row_objects():
                self._fetch(name)
        except OSError as error:
            raise OutputError(f"cannot use {out}: {error.strerror or error}") from error
        self._states = {name: _file_state(self.path / name) for name in self._objects}

    def keep(self) -> None:
        """Send the journal's new rows, if it is time.

        Raises:
            OutputError: they cannot be sent.
        """
        with self._lock:
            if time.monotonic() - self._sent_s >= _SEND_EVERY_S:
                self._send_rows()

    def finish(self) -> None:
        """Put the manifest in place of the parts, or send the rest of the journal.

        Raises:
            OutputError: that failed; what was sent stays.
        """
        with self._lock:
            self._send_rows()
            files = (path for path in self.path.rglob("*") if path.is_file())
            here = {file.relative_to(self.path).as_posix() for file in files}
            for name in sorted(here):
                file = self.path / name
                if not name.startswith(".") and _file_state(file) != self._states.get(name):
                    with atomic_path(self._out / name) as temporary:
                        shutil.copyfile(file, temporary)
            for name, objects in self._objects.items():
                for one in objects if name not in here else ():
                    _delete(self._out / one)
            self._ending.close()

    def _row_objects(self) -> Iterator[str]:
        for beginning in _BEGINNINGS:
            for name in self._out.walk_names(beginning):
                if not name.startswith(beginning):
                    break
                yield name

    def _fetch(self, name: str) -> None:
        """Copy an object; parts become one file again."""
        whole, source = _PART.sub("", name), self._out / name
        file = self.path / whole
        file.parent.mkdir(exist_ok=True)
        part = file.with_name(f"{file.name}.part")
        download(source, part)
        with file.open("ab") as target, part.open("rb") as content:
            shutil.copyfileobj(content, target)
        part.unlink()
        os.utime(file, (source.stat().st_mtime,) * 2)  # the latest row of an input counts
        self._objects.setdefault(whole, []).append(name)

    def _send_rows(self) -> None:
        self._sent_s = time.monotonic()
        for file in self.path.glob(".depthcli-batch*.jsonl"):
            size, sent = file.stat().st_size, self._states.get(file.name, (0, 0))[0]
            if size <= sent:
                continue
            part = f"{file.name}.{time.time_ns():020}-{os.urandom(4).hex()}"
            with (
                atomic_path(self._out / part) as temporary,
                temporary.open("wb") as target,
                file.open("rb") as journal,
            ):
                journal.seek(sent)
                target.write(journal.read(size - sent))
            self._states[file.name] = size, 0
            self._objects.setdefault(file.name, []).append(part)


def rows_folder(out: Path) -> RowsFolder:
    """Where a batch into an output folder has its journal.

    Raises:
        OutputError: a remote folder cannot be read.
    """
    return RemoteRows(out) if isinstance(out, RemotePath) else RowsFolder(out)


def _file_state(file: Path) -> tuple[int, int]:
    status = file.stat()
    return status.st_size, status.st_mtime_ns


def _delete(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise OutputError(f"cannot remove {path}: {error.strerror or error}") from error
