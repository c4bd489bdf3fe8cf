"""Names of HEIF files, and whether they can be read here."""

from functools import cache
from importlib.util import find_spec

HEIF_SUFFIXES = (".heic", ".heif", ".hif")


@cache
def reads_heif() -> bool:
    """Whether pillow-heif is installed; it is not loaded."""
    return find_spec("pillow_heif") is not None
