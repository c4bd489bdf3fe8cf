"""Folders of images and depth files as pairs, whatever their layout, and reading of both.

``cameras.csv`` (the focal length of each image) and ``raw_depth/`` are optional.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import cycle, islice
from pathlib import Path
from typing import Self

import cv2
import numpy as np

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.options import DepthEncoding
from depthcli.core.types import AnyArray, Float32Array, Frame, UInt8Array
from depthcli.errors import DatasetError, InputError, Message
from depthcli.io.calibration import read_lenses
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.images import read
from depthcli.io.images.pixels import turn_beside, upright
from depthcli.io.images.png import SIGNATURE
from depthcli.io.storage.paths import read_bytes
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions, StoredDepth
from depthcli.io.stored.metadata import LEAST, UINT16_MAX, number, step_unit
from depthcli.lab.datasets import layouts
from depthcli.lab.datasets.base import DepthDataset, Pair

CAMERAS_NAME = "cameras.csv"  #: ``id,focal_px``: focal length of each image, in its own pixels
PLAUSIBLE_M = (0.1, 100.0)  #: range of the median depth of data, outside which its unit is wrong
_UNIT_ADVICE = (
    "check the unit, which {png_scale} ('eval pairs') or data.units_per_metre ('train') states"
)
_SIMILAR_ASPECT = 0.01  # relative difference up to which two sizes are of one view
_MOST_OFF_CENTRE = 0.15  # of the size by which a principal point is off the middle of an image


@contextmanager
def as_dataset_error() -> Iterator[None]:
    """Raise errors of files as errors of the data set."""
    try:
        yield
    except InputError as error:
        raise DatasetError(error.message) from error


def read_truth(path: Path, options: DepthReadOptions) -> StoredDepth:
    """Measured depth of a file in any format that is read."""
    with as_dataset_error():
        stored = read_stored_depth(path, options)
    if not stored.depth.is_metric:
        raise DatasetError(f"{path} holds {stored.depth.kind} depth, which is not metric")
    return stored


def metres(stored: StoredDepth) -> Float32Array:
    """(H, W) float32 metres, 0 where there is none: also where 16 bits do not hold the depth."""
    depth, scale = stored.displayed, stored.scale
    most_m = np.inf
    if stored.is_integer and scale is not None:  # in 7-Scenes, 65535 is no depth
        most_m = (UINT16_MAX - 0.5) / scale.units_per_metre
    return np.where(depth.valid & (depth.values < most_m), depth.values, np.float32(0))


def read_image_rgb(path: Path) -> UInt8Array:
    """Pixels of an image: (H, W, 3) RGB uint8, upright; gray has three equal channels."""
    with as_dataset_error():
        pixels: AnyArray = read.read_image(path).pixels
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    if pixels.dtype != np.uint8:
        raise DatasetError(f"{path} has {pixels.dtype} pixels", "save it with 8 or 16 bits")
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)  # noqa: PLR2004


def sample_positions(count: int, at_most: int = 9) -> list[int]:
    """At most ``at_most`` positions of samples, evenly spaced over ``range(count)``."""
    positions = np.linspace(0, count - 1, min(count, at_most)).astype(int)
    return [int(i) for i in np.unique(positions)]


@dataclass(frozen=True)
class FolderDataset(DepthDataset):
    """Pairs of files."""

    root: Path  #: the folder of the files
    reading: DepthReadOptions = AS_STATED  #: what is known about the depth files
    paired: bool = True  #: whether image and depth show the same

    def image(self, i: int) -> UInt8Array:
        """Image of pair ``i``: (H, W, 3) RGB uint8."""
        return read_image_rgb(_file(self.pairs[i].image))

    def frame(self, i: int) -> Frame:
        """Image of pair ``i`` with what its file states."""
        with as_dataset_error():
            return read.read_image(_file(self.pairs[i].image))

    def depth_m(self, i: int) -> Float32Array:
        """Depth of pair ``i`` in the view of its image: (H, W) float32 metres, 0 = none."""
        pair = self.pairs[i]
        depth_m = metres(self.stored(i)) * np.float32(pair.scale)
        if pair.mask is not None:
            try:
                depth_m[np.squeeze(np.load(pair.mask)) == 0] = 0
            except (EOFError, IndexError, OSError, ValueError) as error:
                raise DatasetError(f"{pair.mask} is no mask of {pair.depth}") from error
        if not self.paired:
            return depth_m
        shape, orientation = self.image_facts(i, depth_m.shape)
        turn = turn_beside(depth_m.shape[::-1], shape[::-1], orientation)
        return in_view(upright(depth_m, turn or 1), pair, shape)

    def stored(self, i: int) -> StoredDepth:
        """The depth file of pair ``i``."""
        pair = self.pairs[i]
        camera = pair.depth_camera if pair.depth_camera.has_focal else pair.camera
        kind = self.reading.kind
        if kind in {DepthEncoding.DISTANCE, DepthEncoding.DISPARITY} and not camera.has_focal:
            message = f"{pair.depth} holds {kind}, which needs the focal length"
            raise DatasetError(message, f"give it in {CAMERAS_NAME} (id,focal_px)")
        return read_truth(_file(pair.depth), replace(self.reading, camera=camera))

    def raw_depth_m(self, i: int) -> Float32Array:
        """Measured depth of pair ``i`` from ``raw_depth/``: (H, W) float32 metres, 0 = none."""
        return metres(read_truth(self.root / "raw_depth" / f"{self.pairs[i].id}.png", self.reading))

    def for_camera(self, hfov_deg: float, aspect: float) -> Self:
        """Scale depth for training a network for one camera (docs/cameras.md).

        A network cannot see the focal length: with twice of it, objects look half as far away.
        Images of any aspect (width over height) are stretched to one input.
        """
        angle, scaled = 2 * math.tan(math.radians(hfov_deg) / 2), []
        for i, focal_px in enumerate(self.focal_px):
            width_px = math.sqrt(aspect * math.prod(self.image_facts(i)[0]))
            scaled.append(replace(self.pairs[i], scale=width_px / angle / focal_px))
        return replace(self, pairs=tuple(scaled))

    def with_stated_focal_px(self) -> Self:
        """The focal lengths that the depth images state, if cameras.csv has none."""
        if self.focal_px:
            return self
        with as_dataset_error():
            metadata = [read_metadata(_file(pair.depth)) for pair in self.pairs]
        focals_px = [number(texts.get("focal_px"), LEAST) for texts in metadata]
        if 0 < focals_px.count(None) < len(focals_px):
            silent = self.pairs[focals_px.index(None)].depth
            message = f"{silent} states no focal length, but other depth images beside it do"
            raise DatasetError(message, f"add {CAMERAS_NAME} (id,focal_px) with that of each pair")
        pairs = zip(self.pairs, focals_px, strict=True)
        return replace(self, pairs=tuple(replace(p, camera=Intrinsics(f)) for p, f in pairs))

    def without_unfit_cameras(self) -> tuple[Self, tuple[str, ...]]:
        """The pairs without cameras of images of another size, and a warning about them."""
        first = {pair.camera: i for i, pair in reversed([*enumerate(self.pairs)])}
        sizes = (
            (camera, self.image_facts(i)[0]) for camera, i in first.items() if camera.centre_px
        )
        unfit = {camera for camera, (height, width) in sizes if not _is_of(camera, width, height)}
        if not unfit:
            return self, ()
        pairs = (
            replace(pair, camera=UNKNOWN_CAMERA) if pair.camera in unfit else pair
            for pair in self.pairs
        )
        warning = Message(
            f"{self.root} has cameras of images of another size, which are not used",
            f"state focal_px in {CAMERAS_NAME}",
        )
        return replace(self, pairs=tuple(pairs)), (warning,)

    def image_facts(self, i: int, expected: tuple[int, ...] = ()) -> tuple[tuple[int, int], int]:
        """(rows, columns) of image ``i``, upright, and the orientation that was undone.

        Its header is enough if it is as expected.
        """
        path = _file(self.pairs[i].image)
        with as_dataset_error():
            data = read_bytes(path)
            # JPEG and PNG without EXIF state no orientation, by which the size would be exchanged.
            is_plain = data.startswith((b"\xff\xd8", SIGNATURE))
            may_be_turned = not is_plain or b"Exif" in data or b"eXIf" in data
            header = None if may_be_turned else read.check(data, str(path)).header
        if header and expected in {(), (header.height, header.width)}:
            return (header.height, header.width), 1
        frame = self.frame(i)
        return (frame.height, frame.width), frame.orientation


def _file(path: Path | None) -> Path:
    assert path is not None  # noqa: S101 - the files of each pair are listed
    return path


def in_view(depth_m: Float32Array, pair: Pair, shape: tuple[int, int]) -> Float32Array:
    """Depth, (H, W) float32 metres, at the rows and columns of an image of the same place."""
    (height, width), (rows, columns) = shape, depth_m.shape
    image, depth = pair.camera, pair.depth_camera
    if _is_of(image, width, height) and _is_of(depth, columns, rows):
        ratio_x, ratio_y = (d / i for d, i in zip(_focals(depth), _focals(image), strict=True))
        (from_x, from_y), (to_x, to_y) = image.centre_px or (0, 0), depth.centre_px or (0, 0)
        x = ((np.arange(width) - from_x) * ratio_x + to_x).astype(np.float32)
        y = ((np.arange(height) - from_y) * ratio_y + to_y).astype(np.float32)
        if (height, width) == (rows, columns) and ratio_x == ratio_y == 1:
            return depth_m
        grid = np.meshgrid(x, y)
        # Depth is not interpolated: between near and far there is nothing.
        return np.asarray(cv2.remap(depth_m, *grid, cv2.INTER_NEAREST, borderValue=0), np.float32)
    if (height, width) == (rows, columns):
        return depth_m
    if abs(width * rows / (height * columns) - 1) > _SIMILAR_ASPECT:
        advice = "register the depth to it, or add intrinsic_color.txt and intrinsic_depth.txt"
        message = f"{pair.image} is {width}×{height}, its depth {columns}×{rows}: another view"
        raise DatasetError(message, advice)
    resized = cv2.resize(depth_m, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
    return np.asarray(resized, np.float32)


def _is_of(camera: Intrinsics, width: int, height: int) -> bool:
    """Whether a camera is known, and can be of images of this size."""
    if camera.focal_px is None or camera.centre_px is None:
        return False
    x, y = camera.centre_px
    return max(abs(x / width - 0.5), abs(y / height - 0.5)) < _MOST_OFF_CENTRE


def _focals(camera: Intrinsics) -> tuple[float, float]:
    focal_px = camera.focal_px or 1.0
    return focal_px, focal_px * (camera.pixel_aspect or 1.0)


def open_paired_folder(
    path: Path,
    reading: DepthReadOptions = AS_STATED,
    *,
    patterns: tuple[str, str] | None = None,
    plausible_m: tuple[float, float] = PLAUSIBLE_M,
) -> FolderDataset:
    """Pair images and depth files by patterns of names, or by a known layout."""
    with as_dataset_error():
        listing = layouts.list_pairs(path, patterns)
    units = listing.units_per_metre
    if reading.scale is not None or reading.unstated_scale is not None:
        units = None
    elif units is not None:
        reading = replace(reading, unstated_scale=units)
    dataset, unfit = FolderDataset(listing.pairs, path, reading).without_unfit_cameras()
    dataset = replace(dataset, pairs=_with_cameras(path, dataset.pairs))
    first = dataset.stored(0)
    unit = first.unit_text if units is None else f"{step_unit(units)}, by the layout"
    notes = [f"truth: {listing.layout}, depth in {unit}"]
    if masks := sum(pair.mask is not None for pair in dataset.pairs):
        notes.append(f"masks of validity: {masks} files *_mask beside the depth")
    if listing.left_out:
        notes.append(f"{listing.left_out} files without a partner are left out")
    shape = first.displayed.values.shape
    if dataset.depth_m(0).shape != shape:
        notes.append(f"depth of {shape[1]}×{shape[0]} is compared in the view of the images")
    size, orientation = dataset.image_facts(0)
    if turn_beside(shape[::-1], size[::-1], orientation) is None:
        turned = f"EXIF turned the images (orientation {orientation}); depth is taken as upright"
        unfit = (*unfit, turned)
    if not dataset.focal_px:
        notes.append("focal length: what EXIF states, else what each model assumes")
    check_unit(dataset, path, plausible_m)
    warnings = (*first.warnings_with_scale("png_scale"), *unfit)
    return replace(dataset, notes=tuple(notes), warnings=warnings)


def _with_cameras(path: Path, pairs: tuple[Pair, ...]) -> tuple[Pair, ...]:
    """Pairs with the cameras of cameras.csv, if there is one."""
    table = path / CAMERAS_NAME
    if not table.exists():
        return pairs
    with as_dataset_error():
        lenses = read_lenses(table)
    for pair in pairs:
        if lenses.get(pair.id, UNKNOWN_CAMERA).focal_px is None:
            message = f"{table} has no focal_px of {pair.id!r}: it needs id,focal_px and each pair"
            raise DatasetError(message)
    return tuple(replace(pair, camera=lenses[pair.id]) for pair in pairs)


def open_unpaired_folder(
    path: Path,
    reading: DepthReadOptions = AS_STATED,
    patterns: tuple[str, str] | None = None,
) -> FolderDataset:
    """Images and depth of any names, by :func:`layouts.list_unpaired`; the shorter is repeated."""
    images, depths = layouts.list_unpaired(path, patterns)
    count = max(len(images), len(depths))
    files = islice(zip(cycle(images), cycle(depths), strict=False), count)
    pairs = (Pair(f"{image.name} {depth.name}", image=image, depth=depth) for image, depth in files)
    dataset = FolderDataset(tuple(pairs), path, reading, paired=False)
    check_unit(dataset, path, PLAUSIBLE_M)
    return replace(dataset, warnings=dataset.stored(0).warnings_with_scale("png_scale"))


def check_unit(dataset: DepthDataset, path: Path, range_m: tuple[float, float]) -> None:
    """Check the unit of depth by the medians of some maps."""
    maps_m = map(dataset.depth_m, sample_positions(len(dataset)))
    medians = [float(np.median(d[d > 0])) for d in maps_m if (d > 0).any()]
    typical_m, (low_m, high_m) = float(np.median(medians or [0])), range_m
    if not low_m <= typical_m <= high_m:
        message = f"a median depth of {typical_m:.3g} m, outside {low_m:g}-{high_m:g} m"
        raise DatasetError(f"{path} has {message}", _UNIT_ADVICE)
