"""The version, which packaging, outputs and ``--version`` read here."""

__version__ = "0.36.0"
