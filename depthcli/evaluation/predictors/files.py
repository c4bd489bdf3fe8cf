"""Depth files that another tool wrote, as rows of the table."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import DatasetError, InputError
from depthcli.evaluation.choices import Source
from depthcli.evaluation.predictors.base import Sample
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.depth.stored import StoredDepth

SUFFIXES = (".npy", ".depth.npy", ".exr", ".depth.exr", ".png", ".depth.png")
"""In order of precision; the first that exists is read. Names with ``.depth`` are of predict."""


@dataclass(frozen=True, slots=True)
class FilePredictor:
    """A folder of depth files named by id."""

    folder: Path  #: the folder
    suffix: str  #: suffix of the files that are read
    kind: DepthKind  #: kind of their depth
    scale: float | None = None  #: units per metre of integers that state none; None if not known
    is_scale_assumed: bool = False  #: whether the first file states no scale and none is given
    warnings: tuple[str, ...] = ()  #: about the first file, one line each
    source: Source = Source.FILES  #: always files
    model_sha256: str | None = None  #: always None

    @property
    def name(self) -> str:
        """The folder, as it was given."""
        return str(self.folder)

    def predict(self, sample: Sample) -> DepthMap:
        """Depth of one image as it was written, any size.

        Raises:
            DatasetError: the file is damaged, or states other things than the first one.
        """
        path = self.folder / f"{sample.id}{self.suffix}"
        stored = _read(path, self.kind, self.scale)
        if stored.depth.kind is not self.kind:
            raise DatasetError(
                f"{path} states {stored.depth.kind} depth, and the first file of its folder "
                f"{self.kind} depth: evaluate them in folders of their own"
            )
        if _is_scale_assumed(stored) and not self.is_scale_assumed:
            raise DatasetError(
                f"{path} states no unit, but the first file of its folder does: give "
                "--predictions-scale, for millimetres 1000"
            )
        return stored.displayed


def open_predictions(
    folder: Path,
    ids: Sequence[str],
    kind: DepthKind | None = None,
    scale: float | None = None,
    truth_scale: float | None = None,
) -> FilePredictor:
    """Check that a folder has ``ID.npy``, ``ID.exr`` or ``ID.png`` for every image.

    ``ID.depth.npy`` and so on are accepted, too. ``kind`` is that of files that state none; None
    for metric. ``scale`` is units per metre of PNG, and of integers in NPY, that state none; None
    for millimetres in PNG. ``truth_scale`` is what the user states of the ground truth, for a
    warning.

    Raises:
        DatasetError: the folder or a prediction is missing, or the first file is damaged.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder} is not a folder: give one that holds ID.npy, .exr or .png")
    found = [s for s in SUFFIXES if (folder / f"{ids[0]}{s}").is_file()]
    if not found:
        raise DatasetError(
            f"{folder} has no prediction of {ids[0]}: name the files by id, for example "
            f"{ids[0]}.npy"
        )
    missing = {s: [i for i in ids if not (folder / f"{i}{s}").is_file()] for s in found}
    # A stray file of a more precise format does not stand for the others.
    suffix = next((s for s in found if 2 * len(missing[s]) < len(ids)), found[0])
    if missing[suffix]:
        raise DatasetError(
            f"{folder} lacks {len(missing[suffix])} of {len(ids)} predictions "
            f"(first: {missing[suffix][0]}{suffix}): every image of the split needs one"
        )
    first = _read(folder / f"{ids[0]}{suffix}", kind, scale)
    return FilePredictor(
        folder,
        suffix,
        first.depth.kind,
        scale,
        _is_scale_assumed(first),
        _warnings(first, scale, truth_scale),
    )


def _is_scale_assumed(stored: StoredDepth) -> bool:
    return stored.scale is not None and stored.scale.source == "assumed"


def _warnings(
    first: StoredDepth, scale: float | None, truth_scale: float | None
) -> tuple[str, ...]:
    if not first.depth.is_metric:  # which is fitted to the truth, whatever its scale
        return first.warnings
    if scale is not None and (first.scale is None or first.scale.source == "file"):
        needless = f"{first.name} states its unit, so --predictions-scale has no effect on it"
        return (*first.warnings, needless)
    truth = "" if truth_scale is None else f" (--png-scale {truth_scale:g} is that of the truth)"
    return first.warnings_with_scale(f"--predictions-scale{truth}")


def _read(path: Path, kind: DepthKind | None, scale: float | None) -> StoredDepth:
    try:
        return read_stored_depth(path, unstated_kind=kind, unstated_scale=scale)
    except InputError as error:
        raise DatasetError(str(error)) from error
