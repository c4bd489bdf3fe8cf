"""The files of known depth; free of numpy until they are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.errors import InputError
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.remote import path_of, safe_name

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.core.anchors import AnchorPoints

SUFFIXES = (".csv", ".png", ".exr", ".npy")
"""Suffixes of files with known depth."""
_OUTPUT = ".depth"
"""What the outputs of ``convert`` have before their suffix."""
_ALTERNATIVES = f"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"


@dataclass(frozen=True, slots=True)
class AnchorFiles:
    """A file with known depth, or a folder with one for each picture."""

    path: str  #: the file or the folder
    #: units per metre of PNG and of integers in NPY; None for what the file states, or millimetres
    scale: float | None = None

    def read(self) -> AnchorPoints:
        """Read the file.

        Raises:
            InputError: it cannot be read, or holds no known depth, or there is a scale and its
                format has none.
        """
        path = path_of(self.path)
        if path.suffix.lower() not in SUFFIXES:
            raise InputError(f"{path} holds no known depth; give a file with {_ALTERNATIVES}")
        return self.read_file(path)

    def read_file(self, path: Path) -> AnchorPoints:
        """Read one of the folder's files; raises the errors of :meth:`read`."""
        from depthcli.io.depth.known_depth import read_known_depth  # noqa: PLC0415 - needs numpy

        return read_known_depth(path, self.scale)

    def file_for(
        self, name: str, *, shares_stem: bool = False, picture: Path | None = None
    ) -> Path:
        """The folder's file for a picture.

        For ``a.jpg``, that is ``a.jpg.npy``, else ``a.jpg.depth.npy``, ``a.npy`` or
        ``a.depth.npy``.

        Args:
            name: the picture, relative to its own folder, with ``/`` between the parts.
            shares_stem: whether ``a.npy`` could be that of another picture, such as ``a.png``.
            picture: its file, which is not its known depth, whatever its suffix.

        Raises:
            InputError: there is none, or several, or only one that could be that of another
                picture.
        """
        folder = path_of(self.path)
        above, slash, own = name.rpartition("/")
        base = above + slash + (own.rpartition(".")[0] or own)
        found = _files(folder, name) or _files(folder, name + _OUTPUT)
        if not found:
            found = _files(folder, base, picture) or _files(folder, base + _OUTPUT)
            if found and shares_stem:
                raise InputError(
                    f"{found[0]} may be the known depth of this or of another picture "
                    f"{safe_name(base)}; name it {safe_name(name)}{found[0].suffix}"
                )
        if not found:
            raise InputError(
                f"{folder} has no known depth for it: {safe_name(base)} with {_ALTERNATIVES}"
            )
        if len(found) > 1:
            raise InputError(f"{found[0]} and {found[1]} are both its known depth; remove one")
        return found[0]


def _files(folder: Path, stem: str, picture: Path | None = None) -> list[Path]:
    files = [file for suffix in SUFFIXES if (file := folder / (stem + suffix)).is_file()]
    return [file for file in files if picture is None or not is_same_file(file, picture)]
