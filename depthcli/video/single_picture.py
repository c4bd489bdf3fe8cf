"""What to do with a single picture where a video or an image sequence is expected."""

from pathlib import PurePath

from depthcli.io.listing.folder import EXR_SUFFIX, PICTURE_SUFFIXES
from depthcli.io.listing.heif import HEIF_SUFFIXES
from depthcli.video.number_pattern import pattern_of


def single_picture_advice(name: str) -> str | None:
    """A text that names the file and what to give instead; None if its suffix is no picture's.

    A GIF counts as a video.
    """
    path = PurePath(name)
    suffix = path.suffix.lower()
    if suffix == ".gif" or suffix not in (*PICTURE_SUFFIXES, *HEIF_SUFFIXES, EXR_SUFFIX):
        return None
    pattern = pattern_of(path.stem)
    folder = name.removesuffix(path.name)
    sequence = f"such as '{folder}{pattern}{path.suffix}'" if pattern else "as a folder of its own"
    return f"{name} is a single picture: use 'depthcli predict', or give its sequence, {sequence}"
