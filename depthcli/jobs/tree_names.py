"""Names for the outputs of a whole tree: no two alike, whatever the order of the inputs."""

import hashlib
import os
import unicodedata
from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

_Hashes: TypeAlias = NDArray[np.uint64]
_FIELDS = np.dtype([("name", np.uint64), ("whole", np.uint64), ("stem", np.uint64)])


class TreeNames:
    """What outputs are called before their suffixes.

    An input gives its name without suffix (``a`` for ``a.jpg``). Where another input of that folder
    would give or have the same, it gives all of its name (``a.jpg``); where names differ only in
    what some file systems take for the same (``A.jpg``, ``a.jpg``), a checksum of the name as well.

    A name takes 24 bytes of memory, for hashes. Two hashes that are the same by chance make a
    name longer than it need be, and the same one each time.
    """

    def __init__(self, names: Iterable[str]) -> None:
        """Look at all inputs.

        Args:
            names: paths from the root, with ``/`` between their parts.
        """
        found = np.fromiter(
            (
                (_hash(name), _hash(_normalised(name)), _hash(_normalised(_stem(name))))
                for name in names
            ),
            _FIELDS,
        )
        _, first = np.unique(found["name"], return_index=True)
        self._alike = _repeated(found["whole"][first])
        stems = found["stem"][first]
        # np.intersect1d and np.isin would load numpy.ma, at 15 ms.
        whole = np.sort(found["whole"])
        both = stems[np.take(whole, np.searchsorted(whole, stems), mode="clip") == stems]
        self._shared = np.sort(np.concatenate([_repeated(stems), both]))

    def base(self, name: str) -> str:
        """Path of an input's outputs from the output folder, without a suffix."""
        if _is_in(self._alike, _normalised(name)):
            return f"{name}.{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}"
        return name if _is_in(self._shared, _normalised(_stem(name))) else _stem(name)


def _stem(name: str) -> str:
    return os.path.splitext(name)[0]  # noqa: PTH122 - a name with "/" on any system


def _normalised(name: str) -> str:
    """Names that some file system takes for one are one."""
    return unicodedata.normalize("NFC", name).casefold()


def _hash(name: str) -> int:
    data = name.encode("utf-8", "surrogatepass")
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "big")


def _repeated(hashes: _Hashes) -> _Hashes:
    """Those that are there more than once, in rising order."""
    found, counts = np.unique(hashes, return_counts=True)
    return found[counts > 1]


def _is_in(hashes: _Hashes, name: str) -> bool:
    """Whether a name's hash is one of some in rising order."""
    if not len(hashes):
        return False
    wanted = np.uint64(_hash(name))
    place = int(np.searchsorted(hashes, wanted))
    return place < len(hashes) and bool(hashes[place] == wanted)
