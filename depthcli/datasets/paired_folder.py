"""A folder with ``rgb/`` and ``depth/``: pictures and 16-bit depth images of the same names.

Subfolders are kept and become the scene: ``rgb/kitchen/01.jpg`` belongs to
``depth/kitchen/01.png`` and to the scene "kitchen". ``raw_depth/`` and ``cameras.csv``, which has
the focal length of each picture, are optional.
"""

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import UNKNOWN_CAMERA
from depthcli.datasets.files import (
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    PlausibleDepth,
    check_plausible,
    depth_shape,
    median_m,
    read_depth_m,
    read_image_rgb,
    sample_positions,
)
from depthcli.errors import DatasetError, InputError
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.lens_table import read_lenses

PREDICTION_SUFFIX = ".depth"
"""Suffix of outputs of ``predict`` and ``batch``: ``depth/a.depth.png`` belongs to ``a``."""
CAMERAS_NAME = "cameras.csv"
"""``id,focal_px``: focal length of each picture, in its own pixels."""
PLAUSIBLE = PlausibleDepth(
    0.1,
    100.0,
    "is millimetres unless --png-scale (eval pairs) or data.units_per_metre (train --data) states "
    "another; --pseudo-labels has to be in millimetres",
)


@dataclass(frozen=True, slots=True)
class PairedFolder:
    """Pairs read from image files; a :class:`~depthcli.datasets.base.DepthDataset`."""

    root: Path  #: the folder that holds ``rgb/`` and ``depth/``
    ids: tuple[str, ...]  #: path of each pair below them, without suffix
    scenes: tuple[str, ...]  #: scene of each pair, "" where it is not known
    official_split: tuple[str, ...]  #: "train", "test" or "" for each pair
    images: tuple[Path, ...]  #: file of each picture
    depths: tuple[Path, ...]  #: file of each depth image
    units_per_metre: float = MILLIMETRES  #: value of one metre in the depth images
    focal_px: tuple[float, ...] = ()  #: focal length of each picture; empty if they are not known
    scales: tuple[float, ...] = ()  #: factor on the metres of each pair; empty for 1

    def __len__(self) -> int:
        return len(self.ids)

    def files(self, i: int) -> tuple[Path, ...]:
        """Picture and depth image of pair ``i``."""
        return (self.images[i], self.depths[i])

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture of pair ``i``: (H, W, 3) RGB uint8.

        Raises:
            DatasetError: it cannot be read or has another size than its depth.
        """
        pixels = read_image_rgb(self.images[i])
        height, width = depth_shape(self.depths[i])
        if pixels.shape[:2] != (height, width):
            raise DatasetError(
                f"{self.images[i]} is {pixels.shape[1]}×{pixels.shape[0]} but its depth is "
                f"{width}×{height}: resize one of them"
            )
        return pixels

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i``: (H, W) float32 metres, 0 where there is none.

        Raises:
            DatasetError: it cannot be read.
        """
        scale = self.scales[i] if self.scales else 1.0
        return read_depth_m(self.depths[i], self.units_per_metre / scale)

    def for_camera(self, hfov_deg: float, aspect: float) -> "PairedFolder":
        """The same pairs, with depth scaled for training a network for one camera.

        A network cannot see the focal length: with twice of it, objects look half as far away. So
        depth is divided by the ratio of focal lengths; predictions are multiplied by it again
        (docs/cameras.md).

        Args:
            hfov_deg: horizontal field of view of that camera, degrees.
            aspect: width over height of its pictures; all are stretched to one input.

        Raises:
            DatasetError: a depth image cannot be read.
        """
        shapes = map(depth_shape, self.depths)
        widths = (math.sqrt(aspect * columns * rows) for rows, columns in shapes)
        angle = 2 * math.tan(math.radians(hfov_deg) / 2)
        ratios = zip(widths, self.focal_px, strict=False)
        return replace(self, scales=tuple(width / angle / focal for width, focal in ratios))

    def raw_depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Measured depth of pair ``i`` from ``raw_depth/``: (H, W) float32 metres, 0 = none.

        Raises:
            DatasetError: there is none or it cannot be read.
        """
        raw = self.root / "raw_depth"
        if not raw.is_dir():
            raise DatasetError(
                f"{self.root} has no raw depth: add raw_depth/ID.png, or use "
                "nyu_depth_v2_labeled.mat, which has it"
            )
        return read_depth_m(raw / f"{self.ids[i]}.png", self.units_per_metre)


def open_paired_folder(
    path: Path,
    *,
    units_per_metre: float = MILLIMETRES,
    plausible: PlausibleDepth = PLAUSIBLE,
) -> PairedFolder:
    """Pair the files of ``rgb/`` and ``depth/`` by name; the median depth has to be plausible.

    ``units_per_metre`` is the value of one metre in the depth images: 1000 for millimetres.

    Raises:
        DatasetError: the folder is missing or empty, a file has no partner, depth is not 16-bit
            gray PNG, sizes differ, or the depth is in another unit.
    """
    images = list_files(path, "rgb", IMAGE_SUFFIXES)
    depths = list_files(path, "depth", DEPTH_SUFFIXES)
    _check_pairs(path, images, depths)
    ids = tuple(sorted(images))
    dataset = PairedFolder(
        root=path,
        ids=ids,
        scenes=tuple(pair_id.rpartition("/")[0] for pair_id in ids),
        official_split=("",) * len(ids),
        images=tuple(images[pair_id] for pair_id in ids),
        depths=tuple(depths[pair_id] for pair_id in ids),
        units_per_metre=units_per_metre,
        focal_px=_focal_lengths(path / CAMERAS_NAME, ids),
    )
    check_samples(dataset, plausible)
    return dataset


def _focal_lengths(path: Path, ids: tuple[str, ...]) -> tuple[float, ...]:
    """Focal length of each pair, in pixels; empty if there is no such file."""
    if not path.exists():
        return ()
    try:
        lenses = read_lenses(path)
    except InputError as error:
        raise DatasetError(str(error)) from error
    found = [lenses.get(pair_id, UNKNOWN_CAMERA).focal_px for pair_id in ids]
    if None in found:
        missing = ids[found.index(None)]
        raise DatasetError(
            f"{path} has no focal_px of {missing!r}: it needs id,focal_px and each pair"
        )
    return tuple(focal_px for focal_px in found if focal_px is not None)


def list_files(root: Path, kind: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """Files of ``root/kind`` by their path below it without suffix.

    Raises:
        DatasetError: the folder is missing, holds nothing usable, or two files share a name.
    """
    folder = root / kind
    if not root.is_dir():
        raise DatasetError(f"{root} is not a folder: name one with rgb/ and depth/")
    if not folder.is_dir():
        raise DatasetError(f"{folder} is missing: the data set needs rgb/ and depth/ side by side")
    found: dict[str, Path] = {}
    for file in _files_below(folder):
        if file.name.startswith(".") or file.suffix.lower() not in suffixes or not file.is_file():
            continue
        name = file.relative_to(folder).with_suffix("").as_posix()
        if kind == "depth":
            name = name.removesuffix(PREDICTION_SUFFIX)
        if name in found:
            raise DatasetError(f"{found[name]} and {file} share one name: remove one of them")
        found[name] = file
    if not found:
        raise DatasetError(f"{folder} holds no {', '.join(suffixes)} file: the data set is empty")
    return found


def _files_below(folder: Path) -> list[Path]:
    """All files below a folder, sorted; links are followed, loops are not."""
    found, entered = [], set()
    for parent, folders, names in os.walk(folder, followlinks=True):
        entered.add(os.path.realpath(parent))
        # Sorted, so that the same links are left out in rgb/ and depth/.
        folders[:] = sorted(f for f in folders if os.path.realpath(Path(parent, f)) not in entered)
        found += [Path(parent, name) for name in names]
    return sorted(found)


def _check_pairs(root: Path, images: dict[str, Path], depths: dict[str, Path]) -> None:
    unpaired = sorted(set(images) ^ set(depths))
    if unpaired:
        raise DatasetError(
            f"{root} has {len(images)} pictures and {len(depths)} depth images, "
            f"{len(unpaired)} without a partner (first: {unpaired[0]}): every pair needs both"
        )


def check_samples(dataset: PairedFolder, plausible: PlausibleDepth) -> None:
    """Check the format of every depth image, and the size and unit of a few pairs.

    Raises:
        DatasetError: as :func:`open_paired_folder`.
    """
    for file in dataset.depths:
        depth_shape(file)
    samples = sample_positions(len(dataset))
    dataset.image(samples[0])
    medians_m = [median_m(dataset.depth_m(i)) for i in samples]
    check_plausible(medians_m, plausible, dataset.root)
