"""A folder with ``rgb/`` and ``depth/``: pictures and 16-bit depth images of the same names.

Subfolders are kept and become the scene: ``rgb/kitchen/01.jpg`` belongs to
``depth/kitchen/01.png`` and to the scene "kitchen". ``raw_depth/`` and ``cameras.csv``, which has
the focal length of each picture, are optional.
"""

import math
import os
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import UNKNOWN_CAMERA
from depthcli.errors import DatasetError, InputError
from depthcli.io.depth.metadata import positive_number
from depthcli.io.depth.read import read_metadata
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.images.png import SIGNATURE
from depthcli.io.images.read import decode, read_image
from depthcli.io.listing.folder import is_own_output
from depthcli.io.storage.paths import read_bytes
from depthcli.io.tables import read_lenses

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
DEPTH_SUFFIXES = (".png",)

_PNG_GRAY = 0
_PNG_DEPTH_BITS = 16


def depth_shape(path: Path) -> tuple[int, int]:
    """(rows, columns) of a 16-bit gray PNG, from its header.

    Raises:
        DatasetError: it is missing, not a PNG, has 8 bits, or has colour.
    """
    with as_dataset_error():
        head = read_bytes(path, first=26)
    width, height, bits, colour = struct.unpack(">IIBB", head[16:26].ljust(10, b"\0"))
    if not head.startswith(SIGNATURE) or (bits, colour) != (_PNG_DEPTH_BITS, _PNG_GRAY):
        raise DatasetError(
            f"{path} is not a 16-bit gray PNG, in which depth is stored in millimetres"
        )
    return height, width


def read_depth_m(path: Path, units_per_metre: float) -> npt.NDArray[np.float32]:
    """Depth of a 16-bit gray PNG: (H, W) float32 metres, 0 where there is none.

    Raises:
        DatasetError: the file is missing, truncated, or of another format.
    """
    depth_shape(path)
    with as_dataset_error():
        stored = decode(read_bytes(path), str(path))
    # Division in float64 gives the float32 nearest to 2.718 for 2718 mm.
    depth_m: npt.NDArray[np.float32] = (stored / units_per_metre).astype(np.float32)
    return depth_m


def read_image_rgb(path: Path) -> npt.NDArray[np.uint8]:
    """Pixels of an image: (H, W, 3) RGB uint8, upright; gray has three equal channels.

    Raises:
        DatasetError: the file is missing, truncated, or not an image.
    """
    with as_dataset_error():
        pixels: npt.NDArray[Any] = read_image(path).pixels
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise DatasetError(f"{path} has {pixels.dtype} pixels", "save it with 8 or 16 bits")
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)  # noqa: PLR2004


@contextmanager
def as_dataset_error() -> Iterator[None]:
    """Raise errors of files as errors of the data set."""
    try:
        yield
    except InputError as error:
        raise DatasetError(error.message) from error


class PlausibleDepth(NamedTuple):
    """Range of the median depth of a data set, outside which its unit is wrong."""

    low_m: float
    high_m: float
    advice: str  #: what to do about another unit


def check_plausible(
    medians_m: Iterable[float], plausible: PlausibleDepth, where: Path | str
) -> None:
    """Check the unit of a data set's depth, by the medians of some images.

    Raises:
        DatasetError: the median of the medians is outside the range.
    """
    typical_m = float(np.median(list(medians_m)))
    low_m, high_m, advice = plausible
    if not low_m <= typical_m <= high_m:
        raise DatasetError(
            f"{where} has a median depth of {typical_m:.3g} m, outside {low_m:g}-{high_m:g} m",
            f"check the unit, which {advice}",
        )


def median_m(depth_m: npt.NDArray[np.float32]) -> float:
    """Median of the positive depths, 0 if there are none."""
    positive = depth_m[depth_m > 0]
    return float(np.median(positive)) if positive.size else 0.0


def sample_positions(count: int, at_most: int = 9) -> list[int]:
    """At most ``at_most`` positions of samples, evenly spaced over ``range(count)``."""
    positions = np.linspace(0, count - 1, min(count, at_most)).astype(int)
    return [int(i) for i in np.unique(positions)]


PREDICTION_SUFFIX = ".depth"
"""Suffix of outputs of ``predict`` and ``batch``: ``depth/a.depth.png`` belongs to ``a``."""
CAMERAS_NAME = "cameras.csv"
"""``id,focal_px``: focal length of each picture, in its own pixels."""
PLAUSIBLE = PlausibleDepth(
    0.1,
    100.0,
    "is millimetres unless {png_scale} ('eval pairs') or data.units_per_metre ('train') states "
    "another; {pseudo_labels} has to be in millimetres",
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
        """Scale depth for training a network for one camera.

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
    _check_samples(dataset, plausible)
    return dataset


def _focal_lengths(path: Path, ids: tuple[str, ...]) -> tuple[float, ...]:
    """Focal length of each pair, in pixels; empty if there is no such file."""
    if not path.exists():
        return ()
    with as_dataset_error():
        lenses = read_lenses(path)
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
        raise DatasetError(f"{folder} holds no {', '.join(suffixes)} file: the data set is empty")
    return found


def _check_pairs(root: Path, images: dict[str, Path], depths: dict[str, Path]) -> None:
    unpaired = sorted(set(images) ^ set(depths))
    if unpaired:
        raise DatasetError(
            f"{root} has {len(images)} pictures and {len(depths)} depth images, "
            f"{len(unpaired)} without a partner (first: {unpaired[0]}): every pair needs both"
        )


def _check_samples(dataset: PairedFolder, plausible: PlausibleDepth) -> None:
    """Check the format of every depth image, and the size and unit of a few pairs."""
    for file in dataset.depths:
        depth_shape(file)
    samples = sample_positions(len(dataset))
    dataset.image(samples[0])
    medians_m = [median_m(dataset.depth_m(i)) for i in samples]
    check_plausible(medians_m, plausible, dataset.root)


@dataclass(frozen=True)
class UnpairedFolder:
    """Independent pictures and depth images; a :class:`~depthcli.datasets.base.DepthDataset`.

    It is as long as the longer list, and the shorter one is repeated. Pictures and depth images at
    the same position are not related, and their sizes can differ.
    """

    images: tuple[Path, ...]  #: file of each picture
    depths: tuple[Path, ...]  #: file of each depth image
    units_per_metre: float = MILLIMETRES  #: value of one metre in the depth images

    def __len__(self) -> int:
        return max(len(self.images), len(self.depths))

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Names of the picture and the depth image at each position."""
        names = ((self._image(i).name, self._depth(i).name) for i in range(len(self)))
        return tuple(f"{image} {depth}" for image, depth in names)

    @property
    def scenes(self) -> tuple[str, ...]:
        """Not known: no pair can be held out."""
        return ("",) * len(self)

    @property
    def official_split(self) -> tuple[str, ...]:
        """Not known."""
        return ("",) * len(self)

    def files(self, i: int) -> tuple[Path, ...]:
        """Picture and depth image at position ``i``."""
        return (self._image(i), self._depth(i))

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture ``i``: (H, W, 3) RGB uint8."""
        return read_image_rgb(self._image(i))

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth image ``i``: (H, W) float32 metres, 0 where there is none."""
        return read_depth_m(self._depth(i), self.units_per_metre)

    def _image(self, i: int) -> Path:
        return self.images[i % len(self.images)]

    def _depth(self, i: int) -> Path:
        return self.depths[i % len(self.depths)]


def open_unpaired_folder(path: Path, *, units_per_metre: float = MILLIMETRES) -> UnpairedFolder:
    """List the files of ``rgb/`` and ``depth/``; names need not match.

    Raises:
        DatasetError: a folder is missing or empty, depth is not 16-bit gray PNG, or it is in
            another unit.
    """
    images = list_files(path, "rgb", IMAGE_SUFFIXES)
    depths = list_files(path, "depth", DEPTH_SUFFIXES)
    dataset = UnpairedFolder(
        tuple(images[name] for name in sorted(images)),
        tuple(depths[name] for name in sorted(depths)),
        units_per_metre,
    )
    for file in dataset.depths:
        depth_shape(file)
    medians_m = [
        median_m(read_depth_m(dataset.depths[j], units_per_metre))
        for j in sample_positions(len(depths))
    ]
    check_plausible(medians_m, PLAUSIBLE, path)
    return dataset


@dataclass(frozen=True, slots=True)
class PictureFolder:
    """Pictures; a :class:`~depthcli.datasets.base.DepthDataset` whose depth is 1 m everywhere."""

    ids: tuple[str, ...]  #: path of each picture below the folder, without suffix
    images: tuple[Path, ...]  #: file of each picture

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def scenes(self) -> tuple[str, ...]:
        """Not known: no picture is held out."""
        return ("",) * len(self)

    @property
    def official_split(self) -> tuple[str, ...]:
        """Not known."""
        return ("",) * len(self)

    def files(self, i: int) -> tuple[Path, ...]:
        """Picture ``i``."""
        return (self.images[i],)

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture ``i``: (H, W, 3) RGB uint8."""
        return _read(self.images[i])

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """A plane at 1 m, (H, W) float32, in place of the depth that is not known."""
        return np.ones(self.image(i).shape[:2], np.float32)


# The size of a picture's depth is asked for right after the picture.
_read = lru_cache(maxsize=1)(read_image_rgb)


def open_picture_folder(path: Path) -> PictureFolder:
    """List the pictures of a folder and its subfolders, or of its ``rgb/`` if it has one.

    Raises:
        DatasetError: there is none but outputs of depthcli, or two differ in their suffix only.
    """
    root, kind = (path, "rgb") if (path / "rgb").is_dir() else (path.parent, path.name)
    listed = list_files(root, kind, IMAGE_SUFFIXES)
    files = {name: file for name, file in listed.items() if not is_own_output(str(file))}
    if not files:
        raise DatasetError(f"{root / kind} holds outputs of depthcli only; name photographs")
    return PictureFolder(tuple(sorted(files)), tuple(files[name] for name in sorted(files)))


def stated_focal_px(depths: Sequence[Path]) -> tuple[float, ...]:
    """Focal length that each depth image is for, in its own pixels; empty if none states it.

    Raises:
        DatasetError: some state it and others do not, or a file cannot be read.
    """
    with as_dataset_error():
        found = {path: positive_number(read_metadata(path).get("focal_px")) for path in depths}
    silent = [path for path, focal_px in found.items() if focal_px is None]
    if 0 < len(silent) < len(found):
        raise DatasetError(
            f"{silent[0]} states no focal length, but other depth images beside it do: add "
            "cameras.csv (id,focal_px) with that of each pair"
        )
    return tuple(focal_px for focal_px in found.values() if focal_px is not None)
