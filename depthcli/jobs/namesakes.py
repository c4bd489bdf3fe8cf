"""Files beside an input whose outputs could get the name of its output."""

import os
import unicodedata
from collections.abc import Collection, Iterable, Iterator
from itertools import chain, islice
from pathlib import Path

from depthcli.io.listing.folder import is_media
from depthcli.io.storage.remote import RemotePath

_NEAR = 1000  # names of a store that are skipped rather than asked for again


def stem(name: str) -> str:
    """A name without its suffix."""
    return os.path.splitext(name)[0]  # noqa: PTH122 - a name with "/" on any system


def comparable(name: str) -> str:
    """The name in the form that case- or Unicode-insensitive file systems compare."""
    return unicodedata.normalize("NFC", name).casefold()


def namesakes(folder: Path, own: Collection[str]) -> dict[str, list[str]]:
    """For each input of a folder, the other names there that differ from it in suffixes only.

    Case is ignored, except in a store. There are none if the folder cannot be listed.

    Args:
        folder: is listed once; a store, which may have millions of names, near the inputs only.
        own: names of the inputs.
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
    """Names in a folder; in a store, those that begin with the stem of an own name and a dot.

    Raises:
        OSError: the folder cannot be listed.
    """
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
