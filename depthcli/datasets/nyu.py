"""NYU Depth v2, labelled set: the official .mat file, or the same pairs as image files.

Folder layout: ``rgb/ID.jpg``, ``depth/ID.png`` (uint16 millimetres) and ``index.csv`` with the
columns id, scene, official_split. ``raw_depth/ID.png`` is optional.

Source: Silberman, Hoiem, Kohli and Fergus, "Indoor Segmentation and Support Inference from RGBD
Images", ECCV 2012.

The official ``nyu_depth_v2_labeled.mat``: MATLAB v7.3, which is HDF5 with all axes reversed.

Layout: ``images`` (N, 3, W, H) uint8, ``depths`` and ``rawDepths`` (N, W, H) float32 metres,
``scenes`` object references to arrays of uint16 character codes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.options import INSTALL_H5PY, short_repr
from depthcli.datasets.base import DepthDataset, is_label
from depthcli.datasets.folders import PLAUSIBLE as OWN_PLAUSIBLE
from depthcli.datasets.folders import (
    PairedFolder,
    PlausibleDepth,
    as_dataset_error,
    check_plausible,
    median_m,
    open_paired_folder,
    sample_positions,
)
from depthcli.errors import DatasetError
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.storage.paths import read_bytes
from depthcli.io.tables import CsvTable

MAT_NAME = "nyu_depth_v2_labeled.mat"
_DAMAGED = (AttributeError, KeyError, OSError, RuntimeError, TypeError, ValueError)


@dataclass(frozen=True, slots=True)
class NyuMat:
    """Pairs read from the .mat file; a :class:`~depthcli.datasets.base.DepthDataset`."""

    path: Path  #: the file
    ids: tuple[str, ...]  #: label number of each pair, zero-based, four digits
    scenes: tuple[str, ...]  #: scene of each pair, such as "kitchen_0004"
    #: "" for each pair, as the file does not state it, or that of index.csv
    official_split: tuple[str, ...]
    file: Any  #: the open h5py file; reads are one pair at a time

    def __len__(self) -> int:
        return len(self.ids)

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture of pair ``i``: (H, W, 3) RGB uint8."""
        return np.ascontiguousarray(self._read("images", i).transpose(2, 1, 0), dtype=np.uint8)

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """In-filled depth of pair ``i``: (H, W) float32 metres, 0 where there is none."""
        return np.ascontiguousarray(self._read("depths", i).T, dtype=np.float32)

    def raw_depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Measured depth: (H, W) float32 metres, 0 where nothing was measured."""
        return np.ascontiguousarray(self._read("rawDepths", i).T, dtype=np.float32)

    def _read(self, name: str, i: int) -> npt.NDArray[Any]:
        try:
            return np.asarray(self.file[name][i])
        except _DAMAGED as error:
            raise DatasetError(f"{self.path} is damaged in {name}[{i}]: fetch it again") from error


def open_mat(path: Path, plausible: PlausibleDepth) -> NyuMat:
    """Open the file and check its layout, and that the median depth is plausible.

    Raises:
        DatasetError: h5py is not installed, or the file is damaged or has another layout.
    """
    try:
        import h5py  # noqa: PLC0415 - optional, and only this format needs it
    except ImportError as error:
        raise DatasetError(f"reading a .mat file needs h5py: {INSTALL_H5PY}") from error
    try:
        file = h5py.File(path, "r")
        count = _check_layout(path, file)
        references = np.ravel(file["scenes"][()])
        scenes = tuple("".join(map(chr, np.ravel(file[one][()]))) for one in references)
    except _DAMAGED as error:
        raise DatasetError(
            f"{path} is not a complete {MAT_NAME}: fetch it again if it was cut short"
        ) from error
    dataset = NyuMat(
        path=path,
        ids=tuple(f"{i:04d}" for i in range(count)),
        scenes=scenes,
        official_split=("",) * count,
        file=file,
    )
    check_plausible(
        (median_m(dataset.depth_m(i)) for i in sample_positions(count)), plausible, path
    )
    return dataset


def _check_layout(path: Path, file: Any) -> int:  # noqa: ANN401 - h5py has no types
    """Number of pairs, after checking that images and depth agree."""
    images, depths = file["images"].shape, file["depths"].shape
    if len(depths) != 3 or images != (depths[0], 3, *depths[1:]):  # noqa: PLR2004
        raise DatasetError(
            f"{path} holds images {images} and depths {depths}: "
            f"expected (N, 3, W, H) and (N, W, H) as in {MAT_NAME}"
        )
    return int(depths[0])


INDEX_NAME = "index.csv"
PLAUSIBLE = PlausibleDepth(0.8, 9.0, "has to be millimetres (metres in the .mat file)")
"""Depth stored in metres × 256 would read as 0.7 m, in metres × 4000 as 11 m."""

_COLUMNS = ("id", "scene", "official_split")


@dataclass(frozen=True, slots=True)
class IndexRow:
    """A row of index.csv."""

    scene: str
    official_split: str


def open_nyu(path: Path) -> DepthDataset:
    """Open the labelled set.

    Args:
        path: the .mat file, a folder that holds it, or a folder with rgb/, depth/ and index.csv.
            An index.csv beside the .mat file supplies the official split, which the file lacks.

    Raises:
        DatasetError: the set is missing, incomplete, damaged, or in another unit.
    """
    if path.is_file():
        return _open_mat(path)
    if not path.is_dir():
        raise DatasetError(
            f"{path} does not exist: give {MAT_NAME} or a folder with rgb/, depth/ and index.csv"
        )
    if (path / MAT_NAME).is_file():
        return _open_mat(path / MAT_NAME)
    return open_indexed_folder(path)


def has_own_index(folder: Path) -> bool:
    """Whether a folder's index.csv is of pairs of one's own, with other ids than NYU's numbers.

    Raises:
        DatasetError: the index cannot be read.
    """
    if (folder / MAT_NAME).is_file() or not (folder / INDEX_NAME).is_file():
        return False
    return not all(map(is_label, read_index(folder / INDEX_NAME)))


def _open_mat(path: Path) -> NyuMat:
    dataset = open_mat(path, PLAUSIBLE)
    index_path = path.with_name(INDEX_NAME)
    if not index_path.is_file():
        return dataset
    index = read_index(index_path)
    named = tuple(index[i].official_split if i in index else "" for i in dataset.ids)
    return replace(dataset, official_split=named)


def open_indexed_folder(path: Path, *, units_per_metre: float = MILLIMETRES) -> PairedFolder:
    """Open a folder with rgb/, depth/ and index.csv, of NYU Depth v2 or of one's own.

    ``units_per_metre`` is the value of one metre in the depth images: 1000 for millimetres.

    Raises:
        DatasetError: the set is missing, incomplete, damaged, or in another unit.
    """
    index = read_index(path / INDEX_NAME)
    plausible = PLAUSIBLE if all(map(is_label, index)) else OWN_PLAUSIBLE
    pairs = open_paired_folder(path, units_per_metre=units_per_metre, plausible=plausible)
    differing = sorted(set(index) ^ set(pairs.ids))
    if differing:
        raise DatasetError(
            f"{path / INDEX_NAME} lists {len(index)} pairs but the folder holds {len(pairs)} "
            f"(first difference: {differing[0]}): bring them together"
        )
    return replace(
        pairs,
        scenes=tuple(index[i].scene for i in pairs.ids),
        official_split=tuple(index[i].official_split for i in pairs.ids),
    )


def read_index(path: Path) -> dict[str, IndexRow]:
    """Rows of an index.csv by id.

    Raises:
        DatasetError: the file is missing, lacks a column or repeats an id.
    """
    with as_dataset_error():
        table = CsvTable(read_bytes(path), str(path))
        rows = [row.cells for row in table]
    missing = [name for name in _COLUMNS if name not in table.columns]
    if missing:
        raise DatasetError(f"{path} lacks the column {missing[0]}: needs {', '.join(_COLUMNS)}")
    index = {row["id"]: _index_row(path, row) for row in rows}
    if len(index) != len(rows):
        raise DatasetError(f"{path} names {len(rows) - len(index)} ids more than once")
    return index


def _index_row(path: Path, row: Mapping[str, str]) -> IndexRow:
    part = row["official_split"]
    if part not in {"train", "test", ""}:
        raise DatasetError(
            f"{path} has the official split {short_repr(part)}: it is train, test or empty"
        )
    return IndexRow(row["scene"], part)
