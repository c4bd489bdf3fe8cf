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
CAMERA_RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf")
_CONVERSIONS = {
    **dict.fromkeys((*HEIF_SUFFIXES, ".jxl", ".jp2", ".psd", *CAMERA_RAW), "JPEG, PNG or TIFF"),
    **dict.fromkeys((".dpx", ".cin", ".tga", ".hdr"), "EXR or 16-bit TIFF"),
}
"""What to convert pictures of other formats to, by suffix."""
_MAX_REASONS = 6


class Skipped(NamedTuple):
    """A file that is not an input."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    reason: str  #: one of the words above, or the file's suffix


def convert_to(name: str) -> str | None:
    """What to convert a picture to, by its name; None if its format is read here, or unknown."""
    suffix = PurePosixPath(name).suffix.lower()
    return None if suffix in HEIF_SUFFIXES and reads_heif() else _CONVERSIONS.get(suffix)


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
    found = Counter(file.reason for file in skipped if file.reason in _CONVERSIONS)
    if not found:
        return None
    or_install = f", or for HEIC {INSTALL_HEIF}" if found.keys() & set(HEIF_SUFFIXES) else ""
    pictures = "picture" if found.total() == 1 else "pictures"
    return (
        f"{found.total()} {pictures} of a format that is not read ({', '.join(sorted(found))}) "
        f"skipped; convert to JPEG, PNG or TIFF{or_install}"
    )


def exr_hint(skipped: Sequence[Skipped]) -> str | None:
    """What reads the EXR files that a batch skips; None if there are none."""
    if all(file.reason != ".exr" for file in skipped):
        return None
    return "'depthcli video' reads a sequence of EXR, 'predict' and 'batch --files' single ones"
