"""What can be chosen about a protocol; free of numpy, so that help texts can list it."""

from enum import StrEnum


class Crop(StrEnum):
    """Which part of the frame is compared."""

    NONE = "none"
    """The full frame."""
    EIGEN = "eigen"
    """Rows 45 to 470 and columns 41 to 600 of 480×640."""


class Mask(StrEnum):
    """Which pixels have a truth."""

    FILLED = "filled"
    """All of the in-filled depth."""
    RAW = "raw"
    """Only where the sensor measured: raw depth > 0."""


class Source(StrEnum):
    """Where a row's numbers come from."""

    MODEL = "model"
    """A model that was run here."""
    FILES = "files"
    """Depth files that another tool wrote."""
    TRIVIAL = "trivial"
    """A predictor that never looks at the picture."""
    PUBLISHED = "published"
    """Printed in the paper; not measured here."""
