"""Enumerations of a protocol's choices; without NumPy, for help texts."""

from enum import StrEnum


class Crop(StrEnum):
    """The part of the frame that is evaluated."""

    NONE = "none"
    """The full frame."""
    EIGEN = "eigen"
    """Rows 45 to 470 and columns 41 to 600 of 480×640."""


class Mask(StrEnum):
    """The pixels that have ground truth."""

    FILLED = "filled"
    """All of the in-filled depth."""
    RAW = "raw"
    """Only where the sensor measured: raw depth > 0."""


class Source(StrEnum):
    """The origin of a row's scores."""

    MODEL = "model"
    """A model that was run here."""
    FILES = "files"
    """Depth files that another tool wrote."""
    TRIVIAL = "trivial"
    """A baseline that ignores the picture."""
    PUBLISHED = "published"
    """Printed in the paper; not measured here."""
