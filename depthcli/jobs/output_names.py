"""Unique names of outputs, independent of the order and the choice of the inputs."""

import hashlib
import os
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

from depthcli.io.listing.folder import is_exr, is_media, is_own_image
from depthcli.io.storage.paths import RemotePath

STDIN_STEM = "stdin"
_NEAR = 1000  # names of a store that are skipped rather than asked for again


def stem(name: str) -> str:
    """A name without its suffix."""
    return os.path.splitext(name)[0]  # noqa: PTH122 - a name with "/" on any system


def comparable(name: str) -> str:
    """The name in the form that case- or Unicode-insensitive file systems compare."""
    return unicodedata.normalize("NFC", name).casefold()


def namesakes(folder: Path, own: Collection[str]) -> set[str]:
    """The other names of a folder that differ from an input there in suffixes only.

    Case is ignored, except in a store, of which only names near the inputs are listed. There are
    none if the folder cannot be listed.
    """

    def keys(name: str) -> set[str]:
        # The output of a.jpg.png is named like that of a.jpg beside another picture a.
        return {comparable(name), comparable(stem(name))}

    taken = {key for name in own for key in keys(name)}
    try:
        near = [other for other in names_near(folder, own) if not taken.isdisjoint(keys(other))]
    except OSError:
        return set()
    return set(near) - set(own)


def names_near(folder: Path, own: Iterable[str]) -> Iterable[str]:
    """Names in a folder; in a store, those that begin with the stem of an own name and a dot."""
    if not isinstance(folder, RemotePath):
        return os.listdir(folder)  # noqa: PTH208 - a name is all that is needed
    stems = map(stem, own)
    return _names_starting(folder, {(stem(s) if is_media(s) else s) + "." for s in stems})


def _names_starting(folder: RemotePath, starts: Iterable[str]) -> Iterator[str]:
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
    """

    def __init__(self, names: Iterable[str] = (), stem: Callable[[str], str] = stem) -> None:
        """Take the names of inputs, paths from the root with ``/``; ``stem`` removes suffixes."""
        self._stem = stem
        # By hash, which takes less memory than names: the only name, or None for several.
        self._whole: dict[int, int | None] = {}
        self._stems: dict[int, int | None] = {}
        for name in names:
            self.add(name)

    def add(self, name: str) -> None:
        """Take another name; one that was added already is not counted again."""
        own = hash(name)
        for owners, key in ((self._whole, name), (self._stems, self._stem(name))):
            place = hash(comparable(key))
            owners[place] = own if owners.get(place, own) == own else None

    def base(self, name: str) -> str:
        """Path of an input's outputs from the output folder, without a suffix."""
        if self._whole.get(hash(comparable(name)), 0) is None:
            return f"{name}.{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}"
        return name if self.is_shared(name) else self._stem(name)

    def is_shared(self, name: str) -> bool:
        """Whether another name has the same stem, or is that stem."""
        stem = self._stem(name)
        place, own = hash(comparable(stem)), hash(name)
        others = {self._stems.get(place, own), self._whole.get(place, own)}
        return others != {own}


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
        names = own | {
            name
            for name in filter(is_media, namesakes(folder, own))
            if not (folder / name).is_dir() and not is_own_image(folder / name)
        }
        others = {name for name in names if not is_exr(name)}
        for them, among in ((own & others, TreeNames(others)), (own - others, TreeNames(names))):
            bases |= {(folder, name): among.base(name) for name in them}
    return [STDIN_STEM if s is None else bases[s.parent, s.name] for s in sources]
