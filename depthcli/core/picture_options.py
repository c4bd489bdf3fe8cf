"""Options for reading pictures; free of numpy, so that they are checked before it loads."""

from typing import NamedTuple


class PictureOptions(NamedTuple):
    """What the files of pictures do not state."""

    #: value of white in 16-bit integers; None for 65535, or what the file states
    white_level: int | None = None
    exposure: float = 0.0  #: stops by which linear light of an EXR is brightened
    layer: str | None = None  #: of an EXR, that is its picture; None for the likeliest


NO_OPTIONS = PictureOptions()
"""What the files state, or the default."""
