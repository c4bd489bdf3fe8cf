"""The pictures and videos below a folder, and which of them are outputs of depthcli."""

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple, Self, TypeAlias

from depthcli.core.options import INSTALL_FORMATS, INSTALL_HEIF
from depthcli.errors import InputError, UsageError
from depthcli.io.formats.table import Format, is_own
from depthcli.io.storage.paths import RemotePath, path_of

EXR_MAGIC = b"v/1\x01"
"""The first bytes of every EXR."""
_IMAGES = (".png", ".exr")
_PICTURE_NAME = r"(?i)(\.(depth(\.\d{6,})?|preview)\.png|depth[^/]*\.exr)$"
_VIDEO_NAME = r"(?i)\.(depth\.mkv|preview\.(mp4|webm|mov))$"


def is_own_picture(path: str | Path) -> bool:
    """Whether a file is a PNG or an EXR that depthcli wrote; in a store, by its name first."""
    path = path_of(path)
    if isinstance(path, RemotePath) and not re.search(_PICTURE_NAME, path.name):
        return False  # saves a request for each input
    try:
        return path.suffix.lower() in _IMAGES and is_own(path)
    except OSError:
        return False


def is_own_exr(data: bytes) -> bool:
    """Whether an EXR, of which the first bytes are enough, was written by depthcli."""
    return Format.EXR.facts.mark in data[:4096]


def is_own_output(path: str) -> bool:
    """Whether a file found in a folder is an output of depthcli.

    Videos are recognized by their names alone; pictures are opened only if their names match.
    """
    if re.search(_VIDEO_NAME, path):
        return True
    return re.search(_PICTURE_NAME, path) is not None and is_own_picture(path)


HEIF_SUFFIXES = (".heic", ".heif", ".hif")
FORMATS_SUFFIXES = (".dpx", ".cin", ".hdr", ".psd", ".jxl", ".jp2", ".tga")
EXTRAS = {
    **dict.fromkeys(HEIF_SUFFIXES, ("pillow_heif", INSTALL_HEIF)),
    **dict.fromkeys(FORMATS_SUFFIXES, ("OpenImageIO", INSTALL_FORMATS)),
}
"""The package that pictures of a suffix need, and how to install it."""


HIDDEN = "hidden"
OWN = "written by depthcli"
EXCLUDED = "excluded"
NOT_INCLUDED = "not included"
TWICE = "listed twice"
CAMERA_RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf")
_MAX_REASONS = 6


class Skipped(NamedTuple):
    """A file that is not an input."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    reason: str  #: one of the words above, or the file's suffix


@cache
def is_installed(package: str) -> bool:
    """Whether an extra's package is installed; it is not loaded."""
    return find_spec(package) is not None


def skip_summary(skipped: Sequence[Skipped]) -> str:
    """Number of skipped files and reasons: ``3 files skipped (2 .txt, 1 hidden)``."""
    counts = Counter(file.reason for file in skipped).most_common()
    shown = [f"{count} {reason}" for reason, count in counts[:_MAX_REASONS]]
    if len(counts) > _MAX_REASONS:
        shown.append(f"{sum(count for _, count in counts[_MAX_REASONS:])} others")
    files = "file" if len(skipped) == 1 else "files"
    return f"{len(skipped)} {files} skipped ({', '.join(shown)})"


def conversion_hint(skipped: Sequence[Skipped]) -> str | None:
    """Advice about pictures of formats that are not read; None if there are none."""
    found = Counter(file.reason for file in skipped if file.reason in (*EXTRAS, *CAMERA_RAW))
    if not found:
        return None
    installs = sorted({EXTRAS[suffix][1] for suffix in found if suffix in EXTRAS})
    or_install = "".join(f", or {install}" for install in installs)
    pictures = "picture" if found.total() == 1 else "pictures"
    return (
        f"{found.total()} {pictures} of a format that is not read ({', '.join(sorted(found))}) "
        f"skipped; convert to JPEG, PNG or TIFF{or_install}"
    )


def exr_hint(skipped: Sequence[Skipped]) -> str | None:
    """Advice for EXR files that a batch skips; None if there are none."""
    if all(file.reason != ".exr" for file in skipped):
        return None
    return "'depthcli video' reads a sequence of EXR, 'predict' and a list of 'batch' single ones"


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
    return suffix in PICTURE_SUFFIXES or (suffix in EXTRAS and is_installed(EXTRAS[suffix][0]))


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
        own = self.of(path)
        return {own, os.path.realpath(own)} if os.path.islink(own) else {own}  # noqa: PTH114


_WILDCARDS = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
_TOKEN = re.compile(r"\*\*/|\*\*|\*|\?|\[!?\]?[^\]/]*\]|.", re.DOTALL)


class NameFilter(NamedTuple):
    """Patterns for paths relative to a root, with ``/`` between their parts.

    A pattern without ``/`` is matched with the last part, in any folder; one with ``/`` with the
    whole path. ``*`` and ``?`` do not match ``/``, ``**`` does.
    """

    include: tuple[re.Pattern[str], ...]  #: a file has to match one of these, if there are any
    exclude: tuple[re.Pattern[str], ...]  #: a file or a folder must match none of these
    include_words: tuple[str, ...]  #: ``include`` as the user gave it

    @classmethod
    def of(cls, include: Sequence[str], exclude: Sequence[str]) -> Self:
        """From patterns as the user gives them.

        Raises:
            UsageError: one is not a valid pattern.
        """
        return cls(tuple(map(_compiled, include)), tuple(map(_compiled, exclude)), tuple(include))

    def refusal(self, name: str) -> str | None:
        """Why a file is not wanted, by its own name and its folders'; None if it is wanted."""
        parts = name.split("/")
        if any(self.excludes("/".join(parts[: at + 1])) for at in range(len(parts))):
            return EXCLUDED
        wanted = not self.include or any(p.fullmatch(name) for p in self.include)
        return None if wanted else NOT_INCLUDED

    def excludes(self, name: str) -> bool:
        """Whether a file or folder is excluded by its own name."""
        return any(pattern.fullmatch(name) for pattern in self.exclude)


ANY = NameFilter((), (), ())
"""Every name."""


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
