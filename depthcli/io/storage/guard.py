"""The guard of existing files, which every output passes before it takes a path's place."""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self, TypeAlias

from depthcli.errors import OutputError
from depthcli.io.storage.paths import RemotePath

_Identity: TypeAlias = tuple[int, int] | str
_ADVICE = "choose another {out}, or replace it with {overwrite}"


@dataclass(frozen=True, slots=True)
class Guard:
    """An existing file is replaced only if depthcli wrote it, or on request; an input never.

    A file without content has nothing to lose, and is replaced as well.

    Attributes:
        is_own: whether depthcli wrote a file that exists; it raises OSError if that cannot be read.
        inputs: the files that are never replaced, as the file system tells them apart.
        overwrite: whether files of other programs may be replaced.
    """

    is_own: Callable[[Path], bool]
    inputs: frozenset[_Identity] = frozenset()
    overwrite: bool = False

    @classmethod
    def of(
        cls, is_own: Callable[[Path], bool], inputs: Iterable[Path], *, overwrite: bool = False
    ) -> Self:
        """Make a guard of inputs, which are looked up now."""
        return cls(is_own, frozenset(map(_identity, inputs)), overwrite)

    def check(self, path: Path) -> None:
        """Check that an output may be written to a path.

        In an object store, that takes one request.

        Raises:
            OutputError: the path is an input, or an existing file that depthcli did not write.
        """
        if self.inputs and _identity(path) in self.inputs:
            raise OutputError(f"{path} is an input and is not replaced", "choose another {out}")
        if not self.overwrite and self._is_foreign(path):
            raise OutputError(f"{path} exists and was not written by depthcli", _ADVICE)

    def checked(self, paths: Iterable[Path]) -> Self:
        """Check outputs before any work is done; returns the guard for writing them.

        Raises:
            OutputError: one of them may not be written.
        """
        for path in paths:
            self.check(path)
        return replace(self, overwrite=True)

    def _is_foreign(self, path: Path) -> bool:
        """Whether there is a file that depthcli did not write."""
        is_remote = isinstance(path, RemotePath)
        try:
            if (not is_remote and not path.stat().st_size) or self.is_own(path):
                return False
            return not is_remote or path.exists()  # a name may have told without a request
        except FileNotFoundError:
            return False
        except PermissionError:
            # Without the right to list, S3 answers 403 for missing objects.
            return not is_remote and os.path.isfile(path)  # noqa: PTH113 - never raises
        except (OSError, ValueError) as error:
            if not is_remote:
                return False  # a folder or an impossible name: writing it tells why
            raise OutputError(f"cannot write {path}: {error}") from error


def _identity(path: Path) -> _Identity:
    """Identity of a file, whatever its names and the links that lead to it."""
    if isinstance(path, RemotePath):
        return str(path)
    place = os.path.realpath(path)  # also through folders that do not exist yet
    try:
        status = os.stat(place)  # noqa: PTH116 - names with any byte pass here
    except (OSError, ValueError):
        return place
    return status.st_dev, status.st_ino
