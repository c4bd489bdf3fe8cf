"""The output formats by name."""

from __future__ import annotations

from importlib import import_module
from pathlib import PurePath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from depthcli.io.writers.base import Writer

# Modules are loaded when a format is used: OpenEXR costs start-up time that PNG need not pay.
WRITERS = {
    "png16": "depthcli.io.writers.png16:Png16Writer",
    "exr": "depthcli.io.writers.exr:ExrWriter",
    "npy": "depthcli.io.writers.npy:NpyWriter",
    "preview": "depthcli.io.writers.preview:PreviewWriter",
    "ply": "depthcli.io.writers.ply:PlyWriter",
    "json": "depthcli.io.writers.sidecar:SidecarWriter",
}

SUFFIXES = {
    "png16": ".depth.png",
    "exr": ".depth.exr",
    "npy": ".depth.npy",
    "preview": ".preview.png",
    "ply": ".ply",
    "json": ".depth.json",
}
"""Ends of the output names, as the classes state them, to name outputs with nothing loaded."""


_LAST_SUFFIXES = {PurePath(end).suffix: name for name, end in reversed(SUFFIXES.items())}


def format_of(path: PurePath) -> str | None:
    """The format that a file's name chooses; None if it chooses none."""
    name = path.name.lower()
    whole = (known for known, end in SUFFIXES.items() if name.endswith(end))
    return next(whole, _LAST_SUFFIXES.get(path.suffix.lower()))


def writer_class(name: str) -> type[Writer]:
    """The class of a format in ``WRITERS``."""
    module, _, attribute = WRITERS[name].partition(":")
    found: type[Writer] = getattr(import_module(module), attribute)
    return found
