"""The table of data sets that are recognized by a file in their folder."""

from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import TypeAlias

from depthcli.datasets.base import DepthDataset

Opener: TypeAlias = Callable[[Path], DepthDataset]

LAYOUTS = {
    "nyu_depth_v2_labeled.mat": "nyu:open_nyu",
    "index.csv": "nyu:open_nyu",
}
"""Name of a file -> ``module:function`` that opens a folder with it; the first match is used."""


def opener_of(folder: Path) -> Opener | None:
    """The function that opens a folder; None if no file is recognized."""
    for name, entry in LAYOUTS.items():
        if (folder / name).is_file():
            found: Opener = resolve_name(f"depthcli.datasets.{entry}")
            return found
    return None
