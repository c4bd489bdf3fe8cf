"""Names for the outputs of a whole tree: no two alike, whatever the order of the inputs."""

import hashlib
import os
import unicodedata
from collections import Counter
from collections.abc import Iterable


class TreeNames:
    """What outputs are called before their suffixes.

    An input gives its name without suffix (``a`` for ``a.jpg``). Where another input of that folder
    would give or have the same, it gives all of its name (``a.jpg``); where names differ only in
    what some file systems take for the same (``A.jpg``, ``a.jpg``), a checksum of the name as well.
    """

    def __init__(self, names: Iterable[str]) -> None:
        """Look at all inputs.

        Args:
            names: paths from the root, with ``/`` between their parts; each once.
        """
        stems: Counter[str] = Counter()
        whole: Counter[str] = Counter()
        for name in names:
            stems[_folded(_stem(name))] += 1
            whole[_folded(name)] += 1
        # Only the exceptions stay in memory.
        self._shared = {stem for stem, count in stems.items() if count > 1 or stem in whole}
        self._alike = {name for name, count in whole.items() if count > 1}

    def base(self, name: str) -> str:
        """Path of an input's outputs from the output folder, without a suffix."""
        if _folded(name) in self._alike:
            return f"{name}.{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}"
        return name if _folded(_stem(name)) in self._shared else _stem(name)


def _stem(name: str) -> str:
    return os.path.splitext(name)[0]  # noqa: PTH122 - a name with "/" on any system


def _folded(name: str) -> str:
    """Names that some file system takes for one are one."""
    return unicodedata.normalize("NFC", name).casefold()
