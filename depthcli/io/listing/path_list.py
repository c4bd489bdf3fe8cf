"""A list of inputs, one a line, as ``find`` and ``git ls-files`` print them."""

from __future__ import annotations

import os

from depthcli.io.listing.folder import InputFile


def parse_list(data: bytes) -> list[str]:
    """Paths of a list, in its order, each once.

    Args:
        data: one path a line; or, where a NUL byte is in it, one before each NUL (``find
            -print0``), which is how names with a newline are listed.
    """
    words = data.split(b"\0") if b"\0" in data else data.splitlines()
    return list(dict.fromkeys(os.fsdecode(word) for word in words if word))


def listed_inputs(words: list[str], root: str) -> tuple[InputFile, ...]:
    """Listed paths, by their names below a folder.

    Args:
        words: absolute paths, or paths from ``root``; or from the working directory, as ``find
            root`` prints them, if more of them exist there.
        root: the folder whose tree is kept. A path outside it is named by all its folders.

    Returns:
        One for each file, sorted by name, so that nothing depends on the order of the list.
    """
    base = os.path.abspath(root)  # noqa: PTH100 - links stay as named
    start = max((root, ""), key=lambda folder: _existing(words, folder))
    named: dict[str, InputFile] = {}
    for word in words:
        path = os.path.join(start, word)  # noqa: PTH118 - keeps "./" and names with any byte
        name = _name(os.path.abspath(path), base)  # noqa: PTH100
        named.setdefault(name, InputFile(name, path))
    return tuple(sorted(named.values(), key=lambda found: os.fsencode(found.name)))


def _existing(words: list[str], folder: str) -> int:
    return sum(os.path.lexists(os.path.join(folder, word)) for word in words)  # noqa: PTH118


def _name(path: str, base: str) -> str:
    inside = path.startswith(base.rstrip(os.sep) + os.sep)
    tail = path[len(base.rstrip(os.sep)) :] if inside else os.path.splitdrive(path)[1]
    return tail.lstrip(os.sep).replace(os.sep, "/")
