"""Options for reading images; free of numpy, so that they are checked before it loads."""

from typing import NamedTuple

from depthcli.core.validation import Rule

WHITE_LEVEL = Rule("a whole number from 1 to 65535", lambda level: 1 <= level <= 0xFFFF)  # noqa: PLR2004
"""Values of white in 16-bit images."""
EXPOSURE = Rule("a number of stops from -20 to 20", lambda stops: abs(stops) <= 20)  # noqa: PLR2004
"""Exposures of images of linear light."""


class ReadOptions(NamedTuple):
    """What the files of images do not state."""

    #: value of white in 16-bit integers; None for 65535, or what the file states
    white_level: int | None = None
    exposure: float = 0.0  #: stops by which linear light of an EXR is brightened
    layer: str | None = None  #: of an EXR, that is its image; None for the likeliest


AS_STATED = ReadOptions()
"""What the files state, or the default."""
