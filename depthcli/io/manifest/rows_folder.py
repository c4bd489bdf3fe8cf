"""The local folder of a batch's rows: its output folder, or a copy of a remote one."""

import os
import re
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from depthcli.errors import OutputError
from depthcli.io.manifest.files import is_row_file
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.paths import RemotePath
from depthcli.io.storage.temporary import temporary_folder
from depthcli.io.storage.transfer import download

_UPLOAD_INTERVAL_S = 5.0
_PREFIXES = (".depthcli-batch", "manifest")
_PART = re.compile(r"\.\d{20}-[0-9a-f]{8}$")


class RowsFolder:
    """The output folder itself."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def sync(self) -> None:
        """Do nothing: the rows are on disk."""

    def finish(self) -> None:
        """Do nothing: the manifest is in place."""


class RemoteRows(RowsFolder):
    """A temporary local copy of the rows of a remote folder.

    Objects cannot be appended to, so new rows of the journal are uploaded every few seconds as
    separate objects; the next batch, on any machine, finds all but the last rows of a killed one.
    """

    def __init__(self, out: RemotePath) -> None:
        """Download the rows.

        Raises:
            OutputError: the folder cannot be read.
        """
        self._out, self._lock, self._uploaded_s = out, threading.Lock(), time.monotonic()
        self._exit_stack = ExitStack()
        super().__init__(self._exit_stack.enter_context(temporary_folder()))
        self._objects: dict[str, list[str]] = {}  # of each file here
        try:
            for name in self._row_objects():
                self._download(name)
        except OSError as error:
            raise OutputError(f"cannot use {out}: {error.strerror or error}") from error
        self._states = {name: _file_state(self.path / name) for name in self._objects}

    def sync(self) -> None:
        """Upload the journal's new rows, if the last upload was long enough ago.

        Raises:
            OutputError: they cannot be uploaded.
        """
        with self._lock:
            if time.monotonic() - self._uploaded_s >= _UPLOAD_INTERVAL_S:
                self._upload_rows()

    def finish(self) -> None:
        """Upload the manifest and delete the parts of the journal, or upload the rest of it.

        Raises:
            OutputError: that failed; what was uploaded stays.
        """
        with self._lock:
            self._upload_rows()
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
            self._exit_stack.close()

    def _row_objects(self) -> Iterator[str]:
        for prefix in _PREFIXES:
            for name in self._out.walk_names(prefix):
                if not name.startswith(prefix):
                    break
                if is_row_file(_PART.sub("", name).partition("/")[0]):
                    yield name

    def _download(self, name: str) -> None:
        """Download an object; parts are joined to one file."""
        whole, source = _PART.sub("", name), self._out / name
        file = self.path / whole
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_name(f"{file.name}.part")
        download(source, part)
        with file.open("ab") as target, part.open("rb") as content:
            shutil.copyfileobj(content, target)
        part.unlink()
        os.utime(file, (source.stat().st_mtime,) * 2)  # the latest row of an input counts
        self._objects.setdefault(whole, []).append(name)

    def _upload_rows(self) -> None:
        self._uploaded_s = time.monotonic()
        for file in self.path.glob(".depthcli-batch*.jsonl"):
            size, uploaded = file.stat().st_size, self._states.get(file.name, (0, 0))[0]
            if size <= uploaded:
                continue
            part = f"{file.name}.{time.time_ns():020}-{os.urandom(4).hex()}"
            with (
                atomic_path(self._out / part) as temporary,
                temporary.open("wb") as target,
                file.open("rb") as journal,
            ):
                journal.seek(uploaded)
                target.write(journal.read(size - uploaded))
            self._states[file.name] = size, 0
            self._objects.setdefault(file.name, []).append(part)


def rows_folder(out: Path) -> RowsFolder:
    """The local folder for the journal of a batch that writes to an output folder.

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
