"""Files that are not inputs, and why."""

from collections import Counter
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import NamedTuple

from depthcli.core.extras import INSTALL_HEIF
from depthcli.io.listing.heif import HEIF_SUFFIXES, reads_heif

HIDDEN = "hidden"
OWN = "written by depthcli"
EXCLUDED = "excluded"
NOT_INCLUDED = "not included"
TWICE = "listed twice"
_UNREADABLE_PICTURES = frozenset(
    (
        *HEIF_SUFFIXES,
        *(".jxl", ".jp2", ".psd"),
        *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf"),
    )
)
_MAX_REASONS = 6


class Skipped(NamedTuple):
    """A file that is not an input."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    reason: str  #: one of the words above, or the file's suffix


def is_unread_picture(name: str) -> bool:
    """Whether a name is that of a picture of a format that is not read here."""
    suffix = PurePosixPath(name).suffix.lower()
    return suffix in _UNREADABLE_PICTURES and not (suffix in HEIF_SUFFIXES and reads_heif())


def skip_summary(skipped: Sequence[Skipped]) -> str:
    """How many files, and why: ``3 files skipped (2 .txt, 1 hidden)``."""
    counts = Counter(file.reason for file in skipped).most_common()
    shown = [f"{count} {reason}" for reason, count in counts[:_MAX_REASONS]]
    if len(counts) > _MAX_REASONS:
        shown.append(f"{sum(count for _, count in counts[_MAX_REASONS:])} others")
    files = "file" if len(skipped) == 1 else "files"
    return f"{len(skipped)} {files} skipped ({', '.join(shown)})"


def conversion_hint(skipped: Sequence[Skipped]) -> str | None:
    """Advice about pictures of formats that are not read; None if there are none."""
    found = Counter(file.reason for file in skipped if file.reason in _UNREADABLE_PICTURES)
    if not found:
        return None
    or_install = f", or for HEIC {INSTALL_HEIF}" if found.keys() & set(HEIF_SUFFIXES) else ""
    pictures = "picture" if found.total() == 1 else "pictures"
    return (
        f"{found.total()} {pictures} of a format that is not read ({', '.join(sorted(found))}) "
        f"skipped; convert to JPEG, PNG or TIFF{or_install}"
    )
