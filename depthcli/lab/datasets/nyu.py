"""NYU Depth v2, labelled set: the official .mat file, or the same pairs as image files.

Files are ``rgb/ID.jpg``, ``depth/ID.png`` (uint16 millimetres), ``index.csv`` with the columns id,
scene, official_split, and optionally ``raw_depth/ID.png``. The .mat file is MATLAB v7.3, which is
HDF5 with all axes reversed: ``images`` (N, 3, W, H) uint8, ``depths`` and ``rawDepths`` (N, W, H)
float32 metres, ``scenes`` references to arrays of uint16 character codes.

Source: Silberman, Hoiem, Kohli and Fergus, "Indoor Segmentation and Support Inference from RGBD
Images", ECCV 2012.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core.options import MILLIMETRES, short_repr
from depthcli.core.types import AnyArray, Float32Array, UInt8Array
from depthcli.errors import DatasetError
from depthcli.io.listing import CsvTable
from depthcli.io.storage.paths import read_bytes
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions
from depthcli.lab.datasets import folders
from depthcli.lab.datasets.base import DepthDataset, Pair, is_label

MAT_NAME = "nyu_depth_v2_labeled.mat"
_ENVIRONMENT = "DEPTHCLI_NYU"
# As loaders of the data set publish them, among them that of torch-uncertainty.
_WHOLE = "2,972,037,809 bytes, MD5 520609c519fba3ba5ac58c8fefcc3530"
_PAGE = "https://cs.nyu.edu/~silberman/datasets/nyu_depth_v2.html"
_DAMAGED = (AttributeError, KeyError, OSError, RuntimeError, TypeError, ValueError)
INDEX_NAME = "index.csv"
PLAUSIBLE_M = (0.8, 9.0)  #: metres × 256 would read as 0.7 m, metres × 4000 as 11 m
_COLUMNS = ("id", "scene", "official_split")


@dataclass(frozen=True)
class NyuMat(DepthDataset):
    """Pairs read from the .mat file, whose ids are their positions in it."""

    path: Path  #: the file
    file: Any  #: the open h5py file; reads are one pair at a time

    def image(self, i: int) -> UInt8Array:
        """Image of pair ``i``: (H, W, 3) RGB uint8."""
        return np.ascontiguousarray(self._read("images", i).transpose(2, 1, 0), dtype=np.uint8)

    def depth_m(self, i: int) -> Float32Array:
        """In-filled depth of pair ``i``: (H, W) float32 metres, 0 where there is none."""
        return np.ascontiguousarray(self._read("depths", i).T, dtype=np.float32)

    def raw_depth_m(self, i: int) -> Float32Array:
        """Measured depth: (H, W) float32 metres, 0 where nothing was measured."""
        return np.ascontiguousarray(self._read("rawDepths", i).T, dtype=np.float32)

    def _read(self, name: str, i: int) -> AnyArray:
        try:
            return np.asarray(self.file[name][int(self.pairs[i].id)])
        except _DAMAGED as error:
            raise DatasetError(f"{self.path} is damaged in {name}[{i}]: fetch it again") from error


def open_mat(path: Path) -> NyuMat:
    """Open the file; an index.csv beside it supplies the official split, which the file lacks."""
    try:
        import h5py  # noqa: PLC0415 - optional, and only this format needs it
    except ImportError as error:
        raise DatasetError("reading a .mat file needs h5py: pip install h5py") from error
    try:
        file = h5py.File(path, "r")
        references = np.ravel(file["scenes"][()])
        scenes = ["".join(map(chr, np.ravel(file[reference][()]))) for reference in references]
        _check_arrays(file, len(scenes))
    except _DAMAGED as error:
        advice = f"fetch it again if it was cut short (it has {_WHOLE})"
        raise DatasetError(f"{path} is not a complete {MAT_NAME}", advice) from error
    table, pairs = path.with_name(INDEX_NAME), []
    index = read_index(table) if table.is_file() else {}
    for i, scene in enumerate(scenes):
        name = f"{i:04d}"
        pairs.append(Pair(name, scene, index.get(name, Pair(name)).official_split))
    dataset = NyuMat(tuple(pairs), path, file)
    folders.check_unit(dataset, path, PLAUSIBLE_M)
    return dataset


def _check_arrays(file: Mapping[str, Any], count: int) -> None:
    """ValueError if the arrays are not of this many pairs, of one size, or hold something else."""
    arrays = [file["images"], file["depths"], file.get("rawDepths", file["depths"])]
    shapes = {(count, *arrays[0].shape[-2:])}.union((len(a), *a.shape[-2:]) for a in arrays)
    kinds = "".join(array.dtype.kind for array in arrays)
    if len(shapes) > 1 or kinds != "uff" or arrays[0].shape[1] != 3:  # noqa: PLR2004
        raise ValueError


def located_nyu(path: Path) -> Path:
    """A path, or for the name ``nyu`` that of the environment variable ``DEPTHCLI_NYU``."""
    if path != Path("nyu") or path.exists():
        return path
    if _ENVIRONMENT not in os.environ:
        message = f"{_ENVIRONMENT} does not say where NYU Depth v2 is"
        raise DatasetError(message, f"set it to {MAT_NAME} ({_WHOLE}) from {_PAGE}")
    return Path(os.environ[_ENVIRONMENT])


def open_nyu(path: Path) -> DepthDataset:
    """Open the .mat file, a folder that holds it, or one with rgb/, depth/ and index.csv."""
    path = located_nyu(path)
    if path.is_file():
        return open_mat(path)
    if not path.is_dir():
        advice = f"give {MAT_NAME} or a folder with rgb/, depth/ and index.csv"
        raise DatasetError(f"{path} does not exist", advice)
    if (path / MAT_NAME).is_file():
        return open_mat(path / MAT_NAME)
    if not (path / INDEX_NAME).is_file():
        message = f"{path} is not NYU Depth v2: it has neither {MAT_NAME} nor {INDEX_NAME}"
        advice = "compare (exported) models on pairs of your own with 'depthcli eval pairs'"
        raise DatasetError(message, advice)
    return open_indexed_folder(path)


def is_nyu(folder: Path) -> bool:
    """Whether a folder holds the .mat file, or an index.csv with NYU's numbers alone as ids."""
    index, mat = folder / INDEX_NAME, folder / MAT_NAME
    return mat.is_file() or (index.is_file() and all(map(is_label, read_index(index))))


def open_indexed_folder(path: Path, reading: DepthReadOptions = AS_STATED) -> folders.FolderDataset:
    """Open a folder with rgb/, depth/ and index.csv, of NYU Depth v2 or of one's own."""
    index = read_index(path / INDEX_NAME)
    if all(map(is_label, index)):
        millimetres = DepthReadOptions(unstated_scale=MILLIMETRES)
        dataset = folders.open_paired_folder(path, millimetres, plausible_m=PLAUSIBLE_M)
        dataset = replace(dataset, notes=())
    else:
        dataset = folders.open_paired_folder(path, reading)
    differing = sorted(set(index) ^ set(dataset.ids))
    if differing:
        counts = f"{len(index)} pairs but the folder holds {len(dataset)}"
        message = f"lists {counts} (first difference: {differing[0]})"
        raise DatasetError(f"{path / INDEX_NAME} {message}")
    pairs = []
    for pair in dataset.pairs:
        scene, split = index[pair.id].scene, index[pair.id].official_split
        pairs.append(replace(pair, scene=scene, official_split=split))
    return replace(dataset, pairs=tuple(pairs))


def read_index(path: Path) -> dict[str, Pair]:
    """Ids, scenes and official split of an index.csv, by id."""
    with folders.as_dataset_error():
        table = CsvTable(read_bytes(path), str(path))
        rows = [row.cells for row in table]
    missing = [name for name in _COLUMNS if name not in table.columns]
    if missing:
        raise DatasetError(f"{path} lacks the column {missing[0]}: needs {', '.join(_COLUMNS)}")
    for part in (row["official_split"] for row in rows):
        if part not in {"train", "test", ""}:
            message = f"has the official split {short_repr(part)}: it is train, test or empty"
            raise DatasetError(f"{path} {message}")
    index = {row["id"]: Pair(row["id"], row["scene"], row["official_split"]) for row in rows}
    if len(index) != len(rows):
        raise DatasetError(f"{path} names {len(rows) - len(index)} ids more than once")
    return index
