"""Unique names of outputs, independent of the order and the choice of the inputs."""

import hashlib
import os
import unicodedata
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.io.listing.folder import is_exr, is_media, is_own_picture
from depthcli.io.storage.paths import RemotePath

STDIN_STEM = "stdin"
_NEAR = 1000  # names of a store that are skipped rather than asked for again


def stem(name: str) -> str:
    """A name without its suffix."""
    return os.path.splitext(name)[0]  # noqa: PTH122 - a name with "/" on any system


def comparable(name: str) -> str:
    """The name in the form that case- or Unicode-insensitive file systems compare."""
    return unicodedata.normalize("NFC", name).casefold()


def namesakes(folder: Path, own: Collection[str]) -> dict[str, list[str]]:
    """For each input of a folder, the other names there that differ from it in suffixes only.

    Case is ignored, except in a store, of which only names near the inputs are listed. There are
    none if the folder cannot be listed.
    """
    owners: dict[str, list[str]] = {}
    for name in own:
        for key in _keys(name):
            owners.setdefault(key, []).append(name)
    found: dict[str, list[str]] = {}
    try:
        for other in names_near(folder, own):
            for name in {name for key in _keys(other) for name in owners.get(key, ())} - {other}:
                found.setdefault(name, []).append(other)
    except OSError:
        return {}
    return found


def _keys(name: str) -> set[str]:
    # The output of a.jpg.png is named like that of a.jpg beside another picture a.
    return {comparable(name), comparable(stem(name))}


def names_near(folder: Path, own: Iterable[str]) -> Iterable[str]:
    """Names in a folder; in a store, those that begin with the stem of an own name and a dot."""
    if not isinstance(folder, RemotePath):
        return os.listdir(folder)  # noqa: PTH208 - a name is all that is needed
    stems = map(stem, own)
    return _names_starting(folder, {(stem(s) if is_media(s) else s) + "." for s in stems})


def _names_starting(folder: RemotePath, starts: Iterable[str]) -> Iterator[str]:
    """Names in a folder of a store with one of these beginnings."""
    names: Iterator[str] = iter(())
    name = ""
    for start in () if folder.is_http else sorted(starts):
        ahead = (one for one in chain([name], islice(names, _NEAR)) if one >= start)
        name = next(ahead, "")
        if not name:
            names = folder.walk_names(start)
            name = next(names, "")
        while name.startswith(start):
            if "/" not in name:
                yield name
            name = next(names, "")


class TreeNames:
    """The names of outputs, without suffix.

    That is the input's name without suffix (``a`` for ``a.jpg``). If another input in its folder
    has the same, it is the full name (``a.jpg``); if names differ only in ways that some file
    systems ignore (``A.jpg``, ``a.jpg``), the full name and a checksum of it.

    A name takes 24 bytes of memory, for hashes. A hash collision makes a name longer than
    necessary, in the same way each time.
    """

    def __init__(self, names: Iterable[str] = (), stem: Callable[[str], str] = stem) -> None:
        """Hash the names of inputs, paths from the root with ``/``; ``stem`` removes suffixes."""
        self._stem = stem
        self._hashes = array("Q")
        self._ambiguous: tuple[set[int], set[int]] | None = None
        for name in names:
            self.add(name)

    def add(self, name: str) -> None:
        """Hash another name; one that was added already is not counted again."""
        short = comparable(self._stem(name))
        self._hashes.extend((_hash(name), _hash(comparable(name)), _hash(short)))
        self._ambiguous = None

    def base(self, name: str) -> str:
        """Path of an input's outputs from the output folder, without a suffix."""
        alike, shared = self._ambiguous = self._ambiguous or self._find_ambiguous()
        if _hash(comparable(name)) in alike:
            return f"{name}.{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}"
        short = self._stem(name)
        return name if _hash(comparable(short)) in shared else short

    def is_shared(self, name: str) -> bool:
        """Whether another name has the same stem."""
        return self.base(name) != self._stem(name)

    def _find_ambiguous(self) -> tuple[set[int], set[int]]:
        """Hashes of full names that are alike, and of stems that are shared."""
        names, whole, stems = np.array(self._hashes, np.uint64).reshape(-1, 3).T
        _, first = np.unique(names, return_index=True)
        alike, stems = _repeated(whole[first]), stems[first]
        # np.intersect1d and np.isin would load numpy.ma, at 15 ms.
        whole = np.sort(whole)
        both = stems[np.take(whole, np.searchsorted(whole, stems), mode="clip") == stems]
        return alike, _repeated(stems) | {*both.tolist()}


def _hash(name: str) -> int:
    data = name.encode("utf-8", "surrogatepass")
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "big")


def _repeated(hashes: NDArray[np.uint64]) -> set[int]:
    """Hashes that occur more than once."""
    found, counts = np.unique(hashes, return_counts=True)
    return {*found[counts > 1].tolist()}


def output_bases(sources: Sequence[Path | None]) -> list[str]:
    """The names of each input's outputs, without suffix; None is standard input.

    An EXR gives way to other images and videos with its stem. It does not change their names,
    which are those of a batch: that reads no EXR, since many hold depth or other data.
    """
    inside: dict[Path, set[str]] = {}
    for source in sources:
        if source is not None:
            inside.setdefault(source.parent, set()).add(source.name)
    bases: dict[tuple[Path, str], str] = {}
    for folder, own in inside.items():
        names = own | _rivals(folder, own)
        others = {name for name in names if not is_exr(name)}
        for them, among in ((own & others, TreeNames(others)), (own - others, TreeNames(names))):
            bases |= {(folder, name): among.base(name) for name in them}
    return [STDIN_STEM if s is None else bases[s.parent, s.name] for s in sources]


def _rivals(folder: Path, own: set[str]) -> set[str]:
    """The images and videos beside the inputs of a folder whose outputs could collide."""
    return {
        name
        for name in set(chain(*namesakes(folder, own).values())) - own
        if is_media(name) and not (folder / name).is_dir() and not is_own_picture(folder / name)
    }
