"""Unique names of outputs, independent of the order of the inputs."""

import hashlib
import os
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

STDIN_STEM = "stdin"


def stem(name: str) -> str:
    """A name without its suffix."""
    return os.path.splitext(name)[0]  # noqa: PTH122 - a name with "/" on any system


def sharing_stem(names: Iterable[str], stem: Callable[[str], str] = stem) -> frozenset[str]:
    """Those of some names whose stem is the stem of another, or another name."""
    names = frozenset(names)
    takers = Counter(key for name in names for key in {_folded(name), _folded(stem(name))})
    return frozenset(name for name in names if takers[_folded(stem(name))] > 1)


def _folded(name: str) -> str:
    """The form in which case- or Unicode-insensitive file systems compare a name."""
    return unicodedata.normalize("NFC", name).casefold()


class OutputNames:
    """The names of the outputs of some inputs, without suffix.

    That is the input's name without suffix (``a`` for ``a.jpg``). If another of the inputs has the
    same, it is the full name (``a.jpg``); if names differ only in ways that some file systems
    ignore (``A.jpg``, ``a.jpg``), the full name and a checksum of it.

    Attributes:
        names: the inputs, paths from the root with ``/``.
        longer: the names of outputs that are not the input's name without suffix.
    """

    def __init__(self, names: Iterable[str] = (), stem: Callable[[str], str] = stem) -> None:
        """Name the outputs; ``stem`` removes suffixes."""
        self.names, self._stem = frozenset(names), stem
        shared = sharing_stem(self.names, stem)
        alike = Counter(map(_folded, shared))
        self.longer = {
            name: name if alike[_folded(name)] == 1 else f"{name}.{_checksum(name)}"
            for name in shared
        }

    def base(self, name: str) -> str:
        """Path of an input's outputs from the output folder, without a suffix."""
        return self.longer.get(name) or self._stem(name)


def _checksum(name: str) -> str:
    return hashlib.sha256(os.fsencode(name)).hexdigest()[:8]


def output_bases(sources: Sequence[Path | None]) -> list[str]:
    """The names of each input's outputs, without suffix; None is standard input."""
    inside = defaultdict[Path, list[str]](list)
    for source in filter(None, sources):
        inside[source.parent].append(source.name)
    folders = {folder: OutputNames(names) for folder, names in inside.items()}
    return [STDIN_STEM if s is None else folders[s.parent].base(s.name) for s in sources]
