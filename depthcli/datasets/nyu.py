"""NYU Depth v2, labelled set: the official .mat file, or the same pairs as image files.

Folder layout: ``rgb/ID.jpg``, ``depth/ID.png`` (uint16 millimetres) and ``index.csv`` with the
columns id, scene, official_split. ``raw_depth/ID.png`` is optional.

Source: Silberman, Hoiem, Kohli and Fergus, "Indoor Segmentation and Support Inference from RGBD
Images", ECCV 2012.
"""

import csv
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

from depthcli.core.text import short_repr
from depthcli.datasets.base import DepthDataset
from depthcli.datasets.files import PlausibleDepth
from depthcli.datasets.nyu_mat import MAT_NAME, NyuMat, open_mat
from depthcli.datasets.paired_folder import PLAUSIBLE as OWN_PLAUSIBLE
from depthcli.datasets.paired_folder import PairedFolder, open_paired_folder
from depthcli.datasets.splits import is_label
from depthcli.errors import DatasetError
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.storage.regular import read_regular

INDEX_NAME = "index.csv"
PLAUSIBLE = PlausibleDepth(0.8, 9.0, "has to be millimetres (metres in the .mat file)")
"""Depth stored in metres × 256 would read as 0.7 m, in metres × 4000 as 11 m."""

_MAX_INDEX_BYTES = 2**26
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
    try:
        text = read_regular(path, _MAX_INDEX_BYTES).decode("utf-8-sig")
        reader = csv.DictReader(StringIO(text, newline=""))
        missing = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
        rows = list(reader)
    except OSError as error:
        raise DatasetError(
            f"cannot read {path}: {error.strerror}; it needs the columns {', '.join(_COLUMNS)}. "
            "Pairs of your own are evaluated with 'depthcli eval pairs'"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path} is not CSV in UTF-8: {error}") from error
    if missing:
        raise DatasetError(f"{path} lacks the column {missing[0]}: needs {', '.join(_COLUMNS)}")
    index = {row["id"] or "": _index_row(path, row) for row in rows}
    if len(index) != len(rows):
        raise DatasetError(f"{path} names {len(rows) - len(index)} ids more than once")
    return index


def _index_row(path: Path, row: dict[str, str | None]) -> IndexRow:
    scene, part = row["scene"] or "", row["official_split"] or ""
    if part not in {"train", "test", ""}:
        raise DatasetError(
            f"{path} has the official split {short_repr(part)}: it is train, test or empty"
        )
    return IndexRow(scene, part)
