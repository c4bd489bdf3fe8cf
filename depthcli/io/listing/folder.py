"""The images and videos below a folder, and patterns for their names."""

import os
import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple, Self, TypeAlias

from depthcli.errors import InputError, UsageError, os_errors_as
from depthcli.io.guard import is_own_output
from depthcli.io.media import CAMERA_RAW, EXTRAS, is_media, lower_suffix
from depthcli.io.storage.objects import NO_PATH
from depthcli.io.storage.paths import RemotePath, path_of

HIDDEN = "hidden"
SYSTEM_FOLDERS = frozenset(
    ("@eaDir", "#recycle", "#snapshot", "$RECYCLE.BIN", "System Volume Information", "__MACOSX")
)
"""Folders of Synology's, QNAP's and Windows' systems, and of macOS in archives: no user's files."""
OWN = "written by depthcli"
EXCLUDED = "excluded"
NOT_INCLUDED = "not included"
TWICE = "listed twice"
_MAX_REASONS = 6


class Skipped(NamedTuple):
    """A file that is not an input."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    reason: str  #: one of the words above, the file's suffix, or the name of a system's folder


def skip_summary(skipped: Sequence[Skipped]) -> str:
    """Number of skipped files and reasons: ``3 files skipped (2 .txt, 1 hidden)``."""
    counts = Counter(file.reason for file in skipped).most_common()
    reasons = [f"{count} {reason}" for reason, count in counts[:_MAX_REASONS]]
    if len(counts) > _MAX_REASONS:
        reasons.append(f"{sum(count for _, count in counts[_MAX_REASONS:])} others")
    files = "file" if len(skipped) == 1 else "files"
    return f"{len(skipped)} {files} skipped ({', '.join(reasons)})"


def conversion_hint(skipped: Sequence[Skipped]) -> str | None:
    """Advice about images of formats that are not read in a folder; None if there are none."""
    counts = Counter(file.reason for file in skipped)
    unread = sorted(suffix for suffix in counts if suffix in (*EXTRAS, *CAMERA_RAW))
    if not unread:
        return None
    installs = sorted({EXTRAS[suffix][1] for suffix in unread if suffix in EXTRAS})
    return (
        f"{sum(counts[suffix] for suffix in unread)} skipped of formats that are not read "
        f"({', '.join(unread)}); {', or '.join(('convert to JPEG, PNG or TIFF', *installs))}"
    )


_Identity: TypeAlias = tuple[int, int] | None


class InputFile(NamedTuple):
    """A file below a folder, or a folder that cannot be read."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    path: str  #: its full path or URI
    problem: str | None = None  #: why it cannot be read, if that is known already

    def readable_path(self) -> Path:
        """Its local or remote path."""
        if self.problem is not None:
            raise InputError(self.problem)
        return path_of(self.path)


class Listing(NamedTuple):
    """The content of a folder and its subfolders."""

    #: inputs, by default images and videos, and unreadable folders, in an order that depends on
    #: names alone
    media: list[InputFile]
    #: other files: by default neither image nor video by their suffix, hidden, or outputs
    skipped: list[Skipped]
    loops: list[str]  #: folders left out because they lead back to a folder that they are in

    def add(self, name: str, path: str, reason: str | None) -> None:
        """Add a file, which is skipped for a reason."""
        if reason is None:
            self.media.append(InputFile(name, path))
        else:
            self.skipped.append(Skipped(name, reason))


def why_skipped(path: str) -> str | None:
    """Why a file in a folder is not an input; None if it is one."""
    name = os.path.basename(path)  # noqa: PTH119 - names, not paths
    if name.startswith("."):
        return HIDDEN
    if not is_media(name):
        return lower_suffix(name) or "without suffix"
    return OWN if is_own_output(path) else None


def list_folder(
    root: str,
    *,
    leave_out: str | None = None,
    skip: Callable[[str], bool] = lambda _: False,
    refusal: Callable[[str], str | None] = why_skipped,
) -> Listing:
    """Walk a tree, depth first; links to folders are followed, loops are not.

    Only files that depthcli may have written are opened, for their first bytes.

    Args:
        root: the folder, which may be in a store.
        leave_out: a folder that is not entered, under any of its names; it may be missing.
        skip: whether a folder of this name (from the root, with ``/``) is not entered.
        refusal: why a file of this path is no input; None if it is one.
    """
    place = path_of(root)
    if isinstance(place, RemotePath):
        return _list_objects(place, path_of(leave_out or ""), skip, refusal)
    avoided = (leave_out and _identity(leave_out)) or ()
    listing = Listing([], [], [])
    above: dict[str, tuple[_Identity, ...]] = {root: (_identity(root),)}  # of folders to enter
    named = partial(_name_below, root)

    def not_listed(error: OSError) -> None:
        problem = f"{error.filename} cannot be listed: {error.strerror}"
        listing.media.append(InputFile(named(error.filename) or ".", error.filename, problem))

    for folder, folders, files in os.walk(root, onerror=not_listed, followlinks=True):
        inside, outer = partial(os.path.join, folder), above.pop(folder)
        for path in map(inside, sorted(files, key=os.fsencode)):
            listing.add(named(path), path, refusal(path))
        children, folders[:] = sorted(folders, key=os.fsencode), ()
        for child in children:
            path = inside(child)
            if child.startswith(".") or skip(named(path)):
                continue
            identity = _identity(path)
            if child in SYSTEM_FOLDERS:
                listing.skipped.append(Skipped(named(path), child))
            elif identity in outer:
                listing.loops.append(named(path))
            elif identity != avoided:
                folders.append(child)
                above[path] = (*outer, identity)
    return listing


def _name_below(root: str, path: str) -> str:
    return path[len(root) :].lstrip(os.sep).replace(os.sep, "/")


def _list_objects(
    root: RemotePath,
    leave_out: Path,
    skip: Callable[[str], bool],
    refusal: Callable[[str], str | None],
) -> Listing:
    """Walk the objects of a store, in the order of a local folder."""
    out = f"{leave_out.relative_to(root)}/" if leave_out.is_relative_to(root) else None
    start, folder, is_entered = f"{root.base}/{root.key}".rstrip("/"), None, True
    listing = Listing([], [], [])
    with os_errors_as(UsageError, f"{root} cannot be listed"):
        for name in root.walk_names():
            above = name.rpartition("/")[0]
            if above != folder:  # names come folder by folder
                folder, is_entered = above, not _is_skipped(above, skip)
            # Some tools create an empty object for the folder itself.
            if not name or name.endswith("/") or not is_entered or (out and name.startswith(out)):
                continue
            place = f"{start}/{name}"
            if {"", ".", ".."}.isdisjoint(name.split("/")):
                listing.add(name, place, refusal(place))
            else:
                listing.media.append(InputFile(name, place, f"{place}: {NO_PATH}"))
    if folder is None:
        raise UsageError(f"{root} is not a folder", "name one, or give {files} a list")
    listing.media.sort(key=lambda file: _walk_sort_key(file.name))
    return listing


def _walk_sort_key(name: str) -> list[tuple[bool, bytes]]:
    """Key that sorts names in the order of a walk of folders: files before folders."""
    *above, last = name.encode("utf-8", "surrogateescape").split(b"/")
    return [*((True, part) for part in above), (False, last)]


def _is_skipped(folder: str, skip: Callable[[str], bool]) -> bool:
    parts = folder.split("/") if folder else []
    return any(
        part.startswith(".") or part in SYSTEM_FOLDERS or skip("/".join(parts[: depth + 1]))
        for depth, part in enumerate(parts)
    )


def _identity(path: str) -> _Identity:
    try:
        status = os.stat(path)  # noqa: PTH116 - names with any byte pass here
    except OSError:
        return None
    return status.st_dev, status.st_ino


class RealPaths:
    """Resolves links, with a cache of folders; short-lived, as folders and links change."""

    def __init__(self) -> None:
        self._real_folder = cache(os.path.realpath)

    def of(self, path: str | Path) -> str:
        """The path with links in its folder resolved; if the file is a link, that is kept."""
        folder, name = os.path.split(path)
        return os.path.join(self._real_folder(folder), name)  # noqa: PTH118

    def all_of(self, path: str | Path) -> set[str]:
        """Names of the file, and of the target if it is a link."""
        place = self.of(path)
        return {place, os.path.realpath(place)} if os.path.islink(place) else {place}  # noqa: PTH114


_WILDCARDS = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
_TOKEN = re.compile(r"\*\*/|\*\*|\*|\?|\[!?\]?[^\]/]*\]|.", re.DOTALL)


class NameFilter(NamedTuple):
    """Patterns for paths relative to a root, with ``/`` between their parts.

    A pattern without ``/`` is matched with the last part, in any folder; one with ``/`` with the
    whole path. ``*`` and ``?`` do not match ``/``, ``**`` does.
    """

    include: tuple[re.Pattern[str], ...]  #: a file has to match one of these, if there are any
    exclude: tuple[re.Pattern[str], ...]  #: a file or a folder must match none of these

    @classmethod
    def of(cls, include: Sequence[str], exclude: Sequence[str]) -> Self:
        """From patterns as the user gives them."""
        return cls(tuple(map(_compiled, include)), tuple(map(_compiled, exclude)))

    def refusal(self, name: str) -> str | None:
        """Why a file is not wanted, by its own name and its folders'; None if it is wanted."""
        parts = name.split("/")
        if self.exclude and any(
            self.excludes("/".join(parts[: at + 1])) for at in range(len(parts))
        ):
            return EXCLUDED
        is_included = not self.include or any(p.fullmatch(name) for p in self.include)
        return None if is_included else NOT_INCLUDED

    def excludes(self, name: str) -> bool:
        """Whether a file or folder is excluded by its own name."""
        return any(pattern.fullmatch(name) for pattern in self.exclude)


ANY = NameFilter((), ())  #: every name


def _compiled(pattern: str) -> re.Pattern[str]:
    trimmed = pattern.rstrip("/")
    anywhere = "" if "/" in trimmed else "(?:.*/)?"
    tokens = _TOKEN.findall(trimmed.removeprefix("/").removeprefix("./"))
    try:
        return re.compile(anywhere + "".join(map(_expression, tokens)), re.DOTALL)
    except re.error as error:
        raise UsageError(f"{pattern!r} is not a valid pattern: {error.msg}") from error


def _expression(token: str) -> str:
    if token in _WILDCARDS:
        return _WILDCARDS[token]
    if len(token) > 1:  # a class of characters, [a-z] or [!a-z]
        inner = token[1:-1].replace("\\", "\\\\").replace("[", "\\[")
        return f"[^{inner[1:]}/]" if inner.startswith("!") else f"[{inner}]"
    return re.escape(token)
