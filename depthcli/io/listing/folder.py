"""The pictures and videos below a folder."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeAlias

from depthcli.errors import InputError
from depthcli.io.listing.heif import HEIF_SUFFIXES, reads_heif
from depthcli.io.listing.own_outputs import is_own_output
from depthcli.io.listing.skipped import HIDDEN, OWN, Skipped
from depthcli.io.storage.remote import path_of

PICTURE_SUFFIXES = (
    *(".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".webp", ".avif"),
    *(".bmp", ".dib", ".gif", ".pbm", ".pgm", ".ppm", ".pnm"),
)
EXR_SUFFIX = ".exr"
"""Not among ``PICTURE_SUFFIXES``: most such files in a folder hold no picture."""
VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg"),
    *(".mts", ".m2ts", ".ts", ".mxf", ".wmv", ".flv", ".ogv", ".3gp"),
)
_Identity: TypeAlias = tuple[int, int] | None


class InputFile(NamedTuple):
    """A file below a folder, or a folder that cannot be read."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    path: str  #: its full path or URI
    problem: str | None = None  #: why it cannot be read, if that is known already

    def readable_path(self) -> Path:
        """Its local or remote path.

        Raises:
            InputError: it is known already that it cannot be read.
        """
        if self.problem is not None:
            raise InputError(self.problem)
        return path_of(self.path)


class Listing(NamedTuple):
    """The content of a folder and its subfolders."""

    #: inputs, by default pictures and videos, and unreadable folders, in an order that depends on
    #: names alone
    media: tuple[InputFile, ...]
    #: other files: by default neither picture nor video by their suffix, hidden, or outputs
    skipped: tuple[Skipped, ...]
    loops: tuple[str, ...]  #: folders left out because they lead back to a folder that they are in


def is_video(name: str) -> bool:
    """Whether a name's suffix is a video's."""
    return os.path.splitext(name)[1].lower() in VIDEO_SUFFIXES  # noqa: PTH122 - names, not paths


def is_exr(name: str) -> bool:
    """Whether a name's suffix is that of OpenEXR, which holds pictures or depth."""
    return os.path.splitext(name)[1].lower() == EXR_SUFFIX  # noqa: PTH122 - names, not paths


def is_picture(name: str) -> bool:
    """Whether a name's suffix is that of a picture that is read here, EXR apart."""
    suffix = os.path.splitext(name)[1].lower()  # noqa: PTH122 - names, not paths
    return suffix in PICTURE_SUFFIXES or (suffix in HEIF_SUFFIXES and reads_heif())


def is_media(name: str) -> bool:
    """Whether a name is a picture's or a video's by its suffix, and not hidden."""
    return not name.startswith(".") and (is_picture(name) or is_video(name))


def why_skipped(path: str) -> str | None:
    """Why a file in a folder is not an input; None if it is one."""
    name = os.path.basename(path)  # noqa: PTH119 - names, not paths
    if name.startswith("."):
        return HIDDEN
    if not is_media(name):
        return os.path.splitext(name)[1].lower() or "without suffix"  # noqa: PTH122
    return OWN if is_own_output(path) else None


def list_folder(
    root: str,
    *,
    leave_out: str | None = None,
    skip: Callable[[str], bool] = lambda _: False,
    refusal: Callable[[str], str | None] = why_skipped,
) -> Listing:
    """Walk a tree; links to folders are followed, loops are not.

    Args:
        root: the folder.
        leave_out: a folder that is not entered, under any of its names; it may be missing.
        skip: whether a folder of this name (from the root, with ``/``) is not entered.
        refusal: why a file of this path is no input; None if it is one.

    Returns:
        What is there; files are not opened (except PNGs named like outputs), so any of them may
        turn out to be unreadable.
    """
    avoided = _identity(leave_out) if leave_out is not None else None
    walk = _FolderWalk(avoided, skip, refusal)
    media = tuple(walk.run(root))
    return Listing(media, tuple(walk.skipped), tuple(walk.loops))


class _FolderWalk:
    """One depth-first walk: a stack of folders to enter, each with its parent folders."""

    def __init__(
        self,
        avoided: _Identity,
        skip: Callable[[str], bool],
        refusal: Callable[[str], str | None],
    ) -> None:
        self._avoided, self._skip, self._refusal = avoided, skip, refusal
        self.skipped: list[Skipped] = []
        self.loops: list[str] = []

    def run(self, root: str) -> Iterator[InputFile]:
        stack: list[tuple[str, str, tuple[_Identity, ...]]] = [(root, "", (_identity(root),))]
        while stack:
            folder, name, above = stack.pop()
            try:
                with os.scandir(folder) as entries:
                    children = sorted(entries, key=lambda entry: os.fsencode(entry.name))
            except OSError as error:
                reason = f"{folder} cannot be listed: {error.strerror}"
                yield InputFile(name or ".", folder, reason)
                continue
            folders = []
            for child in children:
                child_name = f"{name}/{child.name}" if name else child.name
                if _is_directory_entry(child):
                    entered = self._enter(child, child_name, above)
                    folders += [(child.path, child_name, entered)] if entered else []
                    continue
                skipped = self._refusal(child.path)
                if skipped is None:
                    yield InputFile(child_name, child.path)
                else:
                    self.skipped.append(Skipped(child_name, skipped))
            stack.extend(reversed(folders))

    def _enter(
        self, child: os.DirEntry[str], name: str, above: tuple[_Identity, ...]
    ) -> tuple[_Identity, ...] | None:
        """The parent folders of a folder's content; None if the folder is not entered."""
        identity = _identity(child.path)
        if child.name.startswith(".") or self._skip(name):
            return None
        if identity is None:  # listing it will say why
            return above
        if identity == self._avoided:
            return None
        if identity in above:
            self.loops.append(name)
            return None
        return (*above, identity)


def _is_directory_entry(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:  # such as a link to itself, which is reported when it is read
        return False


def _identity(path: str) -> _Identity:
    try:
        status = os.stat(path)  # noqa: PTH116 - names with any byte pass here
    except OSError:
        return None
    return status.st_dev, status.st_ino
