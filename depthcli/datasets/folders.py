"""A folder with ``rgb/`` and ``depth/``: images and 16-bit depth images of the same names.

Subfolders are kept and become the scene: ``rgb/kitchen/01.jpg`` belongs to
``depth/kitchen/01.png`` and to the scene "kitchen". ``raw_depth/`` and ``cameras.csv``, which has
the focal length of each image, are optional.
"""

import math
import os
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import UNKNOWN_CAMERA
from depthcli.datasets.base import DepthDataset, Pair
from depthcli.errors import DatasetError, InputError
from depthcli.io.depth.metadata import positive_number
from depthcli.io.depth.read import read_metadata
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.images import png, read
from depthcli.io.storage.paths import read_bytes
from depthcli.io.tables import read_lenses

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
DEPTH_SUFFIXES = (".png",)
PREDICTION_SUFFIX = ".depth"
"""Suffix of outputs of ``predict`` and ``batch``: ``depth/a.depth.png`` belongs to ``a``."""
CAMERAS_NAME = "cameras.csv"
"""``id,focal_px``: focal length of each image, in its own pixels."""
PLAUSIBLE_M = (0.1, 100.0)
"""Range of the median depth of a data set, outside which its unit is wrong."""
_UNIT_ADVICE = (
    "check the unit, which is millimetres unless {png_scale} ('eval pairs') or "
    "data.units_per_metre ('train') states another"
)
_PNG_GRAY = 0
_PNG_DEPTH_BITS = 16


@contextmanager
def as_dataset_error() -> Iterator[None]:
    """Raise errors of files as errors of the data set."""
    try:
        yield
    except InputError as error:
        raise DatasetError(error.message) from error


def depth_shape(path: Path) -> tuple[int, int]:
    """(rows, columns) of a 16-bit gray PNG, from its header.

    Raises:
        DatasetError: it is missing, not a PNG, has 8 bits, or has colour.
    """
    with as_dataset_error():
        head = read_bytes(path, first=26)
    width, height, bits, colour = struct.unpack(">IIBB", head[16:26].ljust(10, b"\0"))
    if not head.startswith(png.SIGNATURE) or (bits, colour) != (_PNG_DEPTH_BITS, _PNG_GRAY):
        raise DatasetError(f"{path} is not a 16-bit gray PNG")
    return height, width


def read_depth_m(path: Path, units_per_metre: float) -> npt.NDArray[np.float32]:
    """Depth of a 16-bit gray PNG: (H, W) float32 metres, 0 where there is none.

    Raises:
        DatasetError: the file is missing, truncated, or of another format.
    """
    depth_shape(path)
    with as_dataset_error():
        stored = read.decode(read_bytes(path), str(path))
    # Division in float64 gives the float32 nearest to 2.718 for 2718 mm.
    depth_m: npt.NDArray[np.float32] = (stored / units_per_metre).astype(np.float32)
    return depth_m


def read_image_rgb(path: Path) -> npt.NDArray[np.uint8]:
    """Pixels of an image: (H, W, 3) RGB uint8, upright; gray has three equal channels.

    Raises:
        DatasetError: the file is missing, truncated, or not an image.
    """
    with as_dataset_error():
        pixels: npt.NDArray[Any] = read.read_image(path).pixels
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise DatasetError(f"{path} has {pixels.dtype} pixels", "save it with 8 or 16 bits")
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)  # noqa: PLR2004


def check_unit(
    maps_m: Iterable[npt.NDArray[np.float32]],
    where: Path,
    range_m: tuple[float, float] = PLAUSIBLE_M,
    advice: str = _UNIT_ADVICE,
) -> None:
    """Check the unit of a data set's depth, by the medians of some maps in metres.

    Raises:
        DatasetError: the median of the medians is outside the range.
    """
    medians = [float(np.median(d[d > 0])) for d in maps_m if (d > 0).any()]
    typical_m, (low_m, high_m) = float(np.median(medians or [0])), range_m
    if not low_m <= typical_m <= high_m:
        raise DatasetError(
            f"{where} has a median depth of {typical_m:.3g} m, outside {low_m:g}-{high_m:g} m",
            advice,
        )


def sample_positions(count: int, at_most: int = 9) -> list[int]:
    """At most ``at_most`` positions of samples, evenly spaced over ``range(count)``."""
    positions = np.linspace(0, count - 1, min(count, at_most)).astype(int)
    return [int(i) for i in np.unique(positions)]


@dataclass(frozen=True)
class FolderDataset(DepthDataset):
    """Pairs read from image files."""

    root: Path  #: the folder of the files
    units_per_metre: float = MILLIMETRES  #: value of one metre in the depth images
    paired: bool = True  #: whether image and depth show the same, pixel by pixel

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Image of pair ``i``: (H, W, 3) RGB uint8.

        Raises:
            DatasetError: it cannot be read or has another size than its depth.
        """
        path, depth = self.pairs[i].image, self.pairs[i].depth
        assert path is not None  # noqa: S101 - the files of each pair are listed
        assert depth is not None  # noqa: S101
        pixels = read_image_rgb(path)
        if self.paired and pixels.shape[:2] != depth_shape(depth):
            height, width = depth_shape(depth)
            raise DatasetError(
                f"{path} is {pixels.shape[1]}×{pixels.shape[0]} but its depth is "
                f"{width}×{height}: resize one of them"
            )
        return pixels

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i``: (H, W) float32 metres, 0 where there is none.

        Raises:
            DatasetError: it cannot be read.
        """
        depth = self.pairs[i].depth
        assert depth is not None  # noqa: S101 - the files of each pair are listed
        return read_depth_m(depth, self.units_per_metre / self.pairs[i].scale)

    def raw_depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Measured depth of pair ``i`` from ``raw_depth/``: (H, W) float32 metres, 0 = none."""
        raw = self.root / "raw_depth" / f"{self.pairs[i].id}.png"
        return read_depth_m(raw, self.units_per_metre)

    def for_camera(self, hfov_deg: float, aspect: float) -> Self:
        """Scale depth for training a network for one camera.

        A network cannot see the focal length: with twice of it, objects look half as far away. So
        depth is divided by the ratio of focal lengths; predictions are multiplied by it again
        (docs/cameras.md).

        Args:
            hfov_deg: horizontal field of view of that camera, degrees.
            aspect: width over height of its images; all are stretched to one input.

        Raises:
            DatasetError: a depth image cannot be read.
        """
        angle = 2 * math.tan(math.radians(hfov_deg) / 2)
        return replace(self, pairs=tuple(_scaled(pair, angle, aspect) for pair in self.pairs))

    def with_stated_focal_px(self) -> Self:
        """The focal lengths that the depth images state, if cameras.csv has none.

        Raises:
            DatasetError: some state it and others do not, or a file cannot be read.
        """
        if self.focal_px:
            return self
        with as_dataset_error():
            found = [replace(pair, focal_px=_stated_focal_px(pair.depth)) for pair in self.pairs]
        silent = [pair.depth for pair in found if pair.focal_px is None]
        if 0 < len(silent) < len(found):
            raise DatasetError(
                f"{silent[0]} states no focal length, but other depth images beside it do",
                f"add {CAMERAS_NAME} (id,focal_px) with that of each pair",
            )
        return replace(self, pairs=tuple(found))


def _scaled(pair: Pair, angle: float, aspect: float) -> Pair:
    if pair.depth is None or pair.focal_px is None:
        return pair
    rows, columns = depth_shape(pair.depth)
    return replace(pair, scale=math.sqrt(aspect * columns * rows) / angle / pair.focal_px)


def _stated_focal_px(depth: Path | None) -> float | None:
    return positive_number(read_metadata(depth).get("focal_px")) if depth else None


def open_paired_folder(
    path: Path,
    *,
    units_per_metre: float = MILLIMETRES,
    plausible_m: tuple[float, float] = PLAUSIBLE_M,
) -> FolderDataset:
    """Pair the files of ``rgb/`` and ``depth/`` by name; the median depth has to be plausible.

    ``units_per_metre`` is the value of one metre in the depth images: 1000 for millimetres.

    Raises:
        DatasetError: the folder is missing or empty, a file has no partner, depth is not 16-bit
            gray PNG, sizes differ, or the depth is in another unit.
    """
    images = list_files(path, "rgb", IMAGE_SUFFIXES)
    depths = list_files(path, "depth", DEPTH_SUFFIXES)
    unpaired = sorted(set(images) ^ set(depths))
    if unpaired:
        raise DatasetError(
            f"{path} has {len(images)} images and {len(depths)} depth images, "
            f"{len(unpaired)} without a partner (first: {unpaired[0]})"
        )
    focal_px = _focal_lengths(path / CAMERAS_NAME, sorted(images))
    pairs = (
        Pair(i, i.rpartition("/")[0], "", images[i], depths[i], focal_px.get(i))
        for i in sorted(images)
    )
    dataset = FolderDataset(tuple(pairs), path, units_per_metre)
    dataset.image(0)
    _check_depth(dataset, plausible_m)
    return dataset


def open_unpaired_folder(path: Path, *, units_per_metre: float = MILLIMETRES) -> FolderDataset:
    """List the files of ``rgb/`` and ``depth/``; names and sizes need not match.

    It is as long as the longer list, and the shorter one is repeated.

    Raises:
        DatasetError: a folder is missing or empty, depth is not 16-bit gray PNG, or it is in
            another unit.
    """
    images = sorted(list_files(path, "rgb", IMAGE_SUFFIXES).items())
    depths = sorted(list_files(path, "depth", DEPTH_SUFFIXES).items())
    pairs = []
    for i in range(max(len(images), len(depths))):
        image, depth = images[i % len(images)][1], depths[i % len(depths)][1]
        pairs.append(Pair(f"{image.name} {depth.name}", image=image, depth=depth))
    dataset = FolderDataset(tuple(pairs), path, units_per_metre, paired=False)
    _check_depth(dataset, PLAUSIBLE_M)
    return dataset


def has_matching_files(path: Path) -> bool:
    """Whether images and depth have the same names and, in the first of them, the same size."""
    images = list_files(path, "rgb", IMAGE_SUFFIXES)
    depths = list_files(path, "depth", DEPTH_SUFFIXES)
    if images.keys() != depths.keys():
        return False
    first = min(images)
    return read_image_rgb(images[first]).shape[:2] == depth_shape(depths[first])


def list_files(root: Path, kind: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """Files of ``root/kind`` by their path below it without suffix.

    Raises:
        DatasetError: the folder is missing, holds nothing usable, or two files share a name.
    """
    folder = root / kind
    if not folder.is_dir():
        raise DatasetError(f"{folder} is missing: the data set needs rgb/ and depth/ side by side")
    found: dict[str, Path] = {}
    walked = os.walk(folder, followlinks=True)
    for file in sorted(Path(parent, name) for parent, _, names in walked for name in names):
        if file.name.startswith(".") or file.suffix.lower() not in suffixes or not file.is_file():
            continue
        name = file.relative_to(folder).with_suffix("").as_posix()
        if kind == "depth":
            name = name.removesuffix(PREDICTION_SUFFIX)
        if name in found:
            raise DatasetError(f"{found[name]} and {file} share one name: remove one of them")
        found[name] = file
    if not found:
        raise DatasetError(f"{folder} holds no {', '.join(suffixes)} file")
    return found


def _focal_lengths(path: Path, ids: list[str]) -> dict[str, float | None]:
    """Focal length of each pair, in pixels; empty if there is no such file."""
    if not path.exists():
        return {}
    with as_dataset_error():
        lenses = read_lenses(path)
    found = {pair_id: lenses.get(pair_id, UNKNOWN_CAMERA).focal_px for pair_id in ids}
    missing = [pair_id for pair_id, focal_px in found.items() if focal_px is None]
    if missing:
        raise DatasetError(
            f"{path} has no focal_px of {missing[0]!r}: it needs id,focal_px and each pair"
        )
    return found


def _check_depth(dataset: FolderDataset, plausible_m: tuple[float, float]) -> None:
    """Check the format of every depth image, and the unit of a few."""
    for pair in dataset.pairs:
        if pair.depth:
            depth_shape(pair.depth)
    samples = map(dataset.depth_m, sample_positions(len(dataset)))
    check_unit(samples, dataset.root, plausible_m)
