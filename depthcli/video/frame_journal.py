"""The journal of finished frames of a sequence, to resume an interrupted run."""

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Self

_NUMBER = re.compile(r"[0-9]{1,18}")


def remove_journal(folder: Path, name: str) -> None:
    """Remove the journal of an earlier run, whose frames are going to be replaced.

    Raises:
        OSError: the folder cannot be written to.
    """
    _journal_path(folder, name).unlink(missing_ok=True)


class FrameJournal:
    """A hidden file beside the frames: a fingerprint, then the numbers of finished frames.

    It is removed when the run is complete or has written no frame, and kept if it is interrupted.

    Attributes:
        is_resumed: whether an earlier run with the same fingerprint was stopped.
        earlier: numbers of frames that an earlier run with the same fingerprint finished.
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
        earlier = _finished(self._path, fingerprint)
        self.is_resumed = earlier is not None
        self.earlier = earlier or frozenset()
        self._count = len(self.earlier)
        self._path.unlink(missing_ok=True)
        self._file = self._path.open("x", encoding="utf-8")
        lines = (json.dumps(fingerprint), *map(str, sorted(self.earlier)))
        self._file.write("".join(f"{line}\n" for line in lines))
        self._file.flush()

    def add(self, number: int) -> None:
        """Record that all files of a frame are written."""
        if number not in self.earlier:
            self._file.write(f"{number}\n")
            self._file.flush()
            self._count += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with suppress(OSError):  # of a full disk, which add has reported already
            self._file.close()
        if kind is None or not self._count:
            self._path.unlink(missing_ok=True)


def _finished(path: Path, fingerprint: str) -> frozenset[int] | None:
    """Numbers of frames that a run with this fingerprint finished; None without such a run."""
    if path.is_symlink() or not path.is_file():
        return None
    head, *lines = path.read_text("utf-8", "replace").splitlines() or [""]
    if head != json.dumps(fingerprint):
        return None
    return frozenset(int(line) for line in lines if _NUMBER.fullmatch(line))


def _journal_path(folder: Path, name: str) -> Path:
    return folder / f".{name}.depthcli-frames"
