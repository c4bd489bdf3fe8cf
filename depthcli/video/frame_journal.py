"""The journal of finished frames of a sequence, to resume an interrupted run."""

import json
import os
import re
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

from depthcli.core.exit_hooks import exit_hook

_MODE = 0o666
_NUMBER = re.compile(r"[0-9]{1,18}")


def remove_journal(folder: Path, name: str) -> None:
    """Remove the journal of an earlier run, whose frames are going to be replaced.

    Raises:
        OSError: the folder cannot be written to.
    """
    _journal_path(folder, name).unlink(missing_ok=True)


class FrameJournal:
    """A hidden file beside the frames: a fingerprint, then the numbers of finished frames.

    It is removed when the run is complete, and kept when it is interrupted.
    """

    def __init__(self, folder: Path, name: str, fingerprint: str) -> None:
        """Read the journal of an earlier run, and begin to write.

        Args:
            folder: of the frames; created if missing.
            name: of the sequence.
            fingerprint: of input, model and options. Frames with another one do not count.

        Raises:
            OSError: the folder cannot be written to.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self._path = _journal_path(folder, name)
        self._fingerprint = fingerprint
        self.is_resumed = False  # whether an earlier run with this fingerprint was stopped
        self.earlier = self._read()
        self._count = len(self.earlier)
        self._exit_hook = exit_hook(self._drop_empty)
        self._file = self._created()

    def add(self, number: int) -> None:
        """Record that all files of a frame are written."""
        if number not in self.earlier:
            self._file.write(f"{number}\n")
            self._file.flush()
            self._count += 1

    def __enter__(self) -> Self:
        self._exit_hook.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._exit_hook.__exit__(None, None, None)
        with suppress(OSError):  # of a full disk, which add has reported already
            self._file.close()
        if kind is None:
            self._path.unlink(missing_ok=True)
        self._drop_empty()

    def _drop_empty(self) -> None:
        if not self._count:
            self._path.unlink(missing_ok=True)

    def _read(self) -> frozenset[int]:
        """Numbers of frames that were done with the same fingerprint."""
        if self._path.is_symlink() or not self._path.is_file():
            return frozenset()
        head, *lines = self._path.read_text("utf-8", "replace").splitlines() or [""]
        if head != json.dumps(self._fingerprint):
            return frozenset()
        self.is_resumed = True
        return frozenset(int(line) for line in lines if _NUMBER.fullmatch(line))

    def _created(self) -> TextIO:
        """Create the file with the frames that count, replacing an old one; follow no links."""
        self._path.unlink(missing_ok=True)
        handle = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _MODE)
        file = os.fdopen(handle, "w", encoding="utf-8")
        numbers = "".join(f"{number}\n" for number in sorted(self.earlier))
        file.write(json.dumps(self._fingerprint) + "\n" + numbers)
        file.flush()
        return file


def _journal_path(folder: Path, name: str) -> Path:
    return folder / f".{name}.depthcli-frames"
