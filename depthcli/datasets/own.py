"""Whatever a method can be trained on: NYU Depth v2, or a folder of one's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.datasets.files import DEPTH_SUFFIXES, IMAGE_SUFFIXES
from depthcli.datasets.nyu import MAT_NAME, open_nyu
from depthcli.datasets.paired_folder import list_files, open_paired_folder
from depthcli.datasets.unpaired_folder import open_unpaired_folder

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.datasets.base import DepthDataset

INDEX_NAME = "index.csv"


def open_training_data(path: Path, *, paired: bool) -> DepthDataset:
    """Open a data set to train on.

    Args:
        path: NYU Depth v2, as :func:`~depthcli.datasets.nyu.open_nyu` takes it; or a folder of
            ``rgb/`` and ``depth/`` without an index, whose subfolders are the scenes.
        paired: each picture needs its depth. If not, and the names in the two folders differ, they
            are two lists that have nothing to do with each other.

    Raises:
        DatasetError: the data is missing, incomplete, damaged, or in another unit.
    """
    is_nyu = not path.is_dir() or (path / MAT_NAME).is_file() or (path / INDEX_NAME).is_file()
    if is_nyu:
        return open_nyu(path)
    if paired or _names(path, "rgb", IMAGE_SUFFIXES) == _names(path, "depth", DEPTH_SUFFIXES):
        return open_paired_folder(path)
    return open_unpaired_folder(path)


def _names(path: Path, kind: str, suffixes: tuple[str, ...]) -> set[str]:
    return set(list_files(path, kind, suffixes))
