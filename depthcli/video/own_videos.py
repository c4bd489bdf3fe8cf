"""Recognizing depth videos that depthcli wrote among its outputs."""

from pathlib import Path

from depthcli.io.formats.table import LABEL_PREFIX
from depthcli.io.listing.own_outputs import foreign_error, replaced_head

_EBML = b"\x1aE\xdf\xa3"
"""The first bytes of every Matroska and WebM."""


def check_replaceable_video(path: Path) -> None:
    """Check that a depth video does not take the place of a Matroska that depthcli did not write.

    As for PNG and EXR, what is not in that format is replaced. Previews have no labels by which
    they could be recognized.

    Raises:
        OutputError: it does, or the store does not answer.
    """
    head = replaced_head(path)  # the labels follow the description of the stream
    if head.startswith(_EBML) and LABEL_PREFIX.encode() not in head:
        raise foreign_error(path)
