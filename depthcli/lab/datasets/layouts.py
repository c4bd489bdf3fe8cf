"""Layouts of folders with pairs: which files are the image and the depth of one pair.

Known by their names: ``rgb/`` and ``depth/`` (also with time stamps, as in TUM RGB-D), ``color/``
and ``depth/`` (ScanNet, Redwood), ``*.color.*`` and ``*.depth.*`` (7-Scenes, 3DMatch), and KITTI;
``trainA/`` and ``trainB/`` of unpaired images and depth; or a list of files in place of a folder.
"""

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.errors import DatasetError, UsageError
from depthcli.io.calibration import read_calibration
from depthcli.io.formats.table import READABLE_SUFFIXES
from depthcli.io.storage.paths import read_bytes
from depthcli.lab.datasets.base import Pair

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")
_IMAGE = rf"(?:{'|'.join(map(re.escape, IMAGE_SUFFIXES))})"
_DEPTH = rf"(?:\.depth)?(?:{'|'.join(map(re.escape, READABLE_SUFFIXES))})"  # as predict names it
_TUM_LISTS = ("rgb.txt", "depth.txt", "groundtruth.txt")
_TUM_UNITS = 5000.0
_PARTS = ("train", "val", "test")  # folders of Ultralytics' data sets
_TIME = re.compile(r"\d+\.\d+")
_MOST_APART_S = 0.02  # difference of time stamps up to which TUM's tools pair image and depth
_CAMERAS = ("intrinsic/intrinsic_{}.txt", "intrinsic_{}.txt", "intrinsics_{}.txt")
_ONE_CAMERA = ("camera-intrinsics.txt", "camera_intrinsics.txt")
_COLOUR_CAMERAS = (*(name.format("color") for name in _CAMERAS), *_ONE_CAMERA)
_DEPTH_CAMERAS = (*(name.format("depth") for name in _CAMERAS), *_ONE_CAMERA)


class Layout(NamedTuple):
    """Names of images and depth below a folder, as expressions whose groups are those of a pair."""

    name: str
    image: str
    depth: str
    units_per_metre: float | None = None  #: by convention; None if it has none


class Listing(NamedTuple):
    """The pairs of a folder."""

    pairs: tuple[Pair, ...]
    layout: str  #: how they are laid out
    units_per_metre: float | None = None  #: by convention of the layout; None if it has none
    left_out: int = 0  #: files without a partner, which some layouts have


_PLAIN = Layout("rgb/ and depth/", rf"rgb/(.+){_IMAGE}", rf"depth/(.+?){_DEPTH}")
_UNPAIRED = Layout(
    "rgb/ and depth/, or trainA/ and trainB/",
    rf"(?:rgb|trainA)/(.+){_IMAGE}",
    rf"(?:depth|trainB)/(.+?){_DEPTH}",
)
_LAYOUTS = (
    _PLAIN,
    Layout(
        "color/ and depth/",
        rf"(.+/)?(?:color|rgb|images?)/(.+){_IMAGE}",
        rf"(.+/)?depths?/(.+?){_DEPTH}",
    ),
    Layout(
        "*.color.* and *.depth.*",
        rf"(.+)[._-](?:color|rgb){_IMAGE}",
        rf"(.+)[._-]depth(?:{'|'.join(map(re.escape, READABLE_SUFFIXES))})",
    ),
    Layout(
        "color_* and depth_*",
        rf"(.*/)?(?:color|rgb)[._-](.+){_IMAGE}",
        rf"(.*/)?depth[._-](.+?){_DEPTH}",
    ),
    Layout(
        "KITTI's validation selection",
        r"(?:.+/)?image/(.+_sync)_image_(\d+_image_0[23])\.png",
        r"(?:.+/)?groundtruth_depth/(.+_sync)_groundtruth_depth_(\d+_image_0[23])\.png",
        256.0,
    ),
    Layout(
        "KITTI",
        r"(?:.+/)?(\w+_sync)/(image_0[23])/data/(\d+)\.(?:png|jpg)",
        r"(?:.+/)?(\w+_sync)/proj_depth/groundtruth/(image_0[23])/(\d+)\.png",
        256.0,
    ),
)


def list_pairs(root: Path, patterns: tuple[str, str] | None = None) -> Listing:
    """Pair the images of a folder with their depth.

    ``patterns`` are those of the paths of images and of depth, where ``*`` stands for what a pair
    has in common; None for the first known layout that fits. ``root`` may be a list of files.
    """
    if root.suffix == ".txt":
        return _listed(root)
    if patterns:
        layout = _layout_of(patterns)
        listing = _paired(root, layout, list_files(root))
        if not listing.pairs:
            raise DatasetError(f"{root} has no files of one name by {layout.name}")
        return listing
    if tables := sorted(root.glob("assoc*.txt")):
        return _listed(tables[0])
    is_plain = (root / "rgb").is_dir() and (root / "depth").is_dir()
    files = list_files(root, ("rgb", "depth") if is_plain else ("",))
    layouts = (_PLAIN,) if is_plain else _LAYOUTS[1:]
    for listing in (_paired(root, layout, files) for layout in layouts):
        if listing.pairs:
            return listing
    names = "rgb/ and depth/, color/ and depth/, *.color.png and *.depth.png, TUM RGB-D or KITTI"
    message = f"{root} has no pairs of image and depth in a known layout: {names}"
    raise DatasetError(message, "name its files with {rgb} and {depth}")


def list_unpaired(
    root: Path, patterns: tuple[str, str] | None = None
) -> tuple[list[Path], list[Path]]:
    """Images and depth files of patterns, or of ``rgb/`` and ``depth/``, sorted by name."""
    layout = _layout_of(patterns) if patterns else _UNPAIRED
    files = list_files(root)
    images, depths = (matching(root, files, e) for e in (layout.image, layout.depth))
    if not (images and depths):
        raise DatasetError(f"{root} has no images or no depth in {layout.name}")
    return [images[name] for name in sorted(images)], [depths[name] for name in sorted(depths)]


def list_files(root: Path, folders: Iterable[str] = ("",)) -> list[str]:
    """Paths of the files below some folders of ``root``, relative to it; hidden ones are not."""
    if not root.is_dir():
        raise DatasetError(f"{root} is not a folder")
    walked = (entry for folder in folders for entry in os.walk(root / folder, followlinks=True))
    files = (Path(parent, name) for parent, _, names in walked for name in names)
    visible = (file for file in files if not file.name.startswith(".") and file.is_file())
    return sorted(file.relative_to(root).as_posix() for file in visible)


def matching(root: Path, files: Iterable[str], expression: str) -> dict[str, Path]:
    """Files whose path is of an expression, by its groups."""
    compiled, paths = re.compile(expression, re.IGNORECASE), dict[str, Path]()
    for file in files:
        match = compiled.fullmatch(file)
        if match is None:
            continue
        name = "/".join(part.strip("/") for part in match.groups() if part)
        if name in paths:
            raise DatasetError(f"{paths[name]} and {root / file} share one name: remove one")
        paths[name] = root / file
    return paths


def _layout_of(patterns: tuple[str, str]) -> Layout:
    image, depth = map(_expression, patterns)
    return Layout(" and ".join(patterns), image, depth)


def _expression(pattern: str) -> str:
    """The expression of a pattern with ``*`` and ``?``; one without ``/`` fits in any folder."""
    if "*" not in pattern:
        raise UsageError(f"{pattern} has no * for the names of the pairs")
    words = {"**/": "(?:(.*)/)?", "**": "(.*)", "*": "([^/]*)", "?": "[^/]"}
    parts = re.split(r"(\*\*/|\*\*|\*|\?)", pattern.removeprefix("./"))
    anywhere = "" if "/" in pattern else words["**/"]  # as in ``--include``
    return anywhere + "".join(words.get(part) or re.escape(part) for part in parts)


def _paired(root: Path, layout: Layout, files: list[str]) -> Listing:
    images, depths = (matching(root, files, e) for e in (layout.image, layout.depth))
    partner_of = {name: name for name in sorted(images) if name in depths}
    is_complete, units = layout is _PLAIN, layout.units_per_metre
    if layout is _PLAIN and images and depths and not partner_of:
        partner_of, is_complete = _nearest_in_time(images, depths), False
        if any((root / name).is_file() for name in _TUM_LISTS):
            units = _TUM_UNITS
    unpaired = sorted((images.keys() - partner_of.keys()) | (depths.keys() - partner_of.values()))
    if (layout is _PLAIN and not partner_of) or (is_complete and unpaired):
        first = f" (first: {unpaired[0]})" if unpaired else ""
        counts = f"{len(images)} images and {len(depths)} depth images, {len(unpaired)}"
        advice = "name the files with {rgb} and {depth} if their names differ"
        raise DatasetError(f"{root} has {counts} without a partner{first}", advice)
    pairs = [_pair(root, name, images[name], depths[partner_of[name]]) for name in partner_of]
    return Listing(tuple(pairs), layout.name, units, len(unpaired))


def _pair(root: Path, name: str, image: Path, depth: Path) -> Pair:
    kitti = image.parent / "../intrinsics" / f"{image.stem}.txt"  # of its selection
    camera = _camera_near(image.parent, root, _COLOUR_CAMERAS)
    camera = read_calibration(kitti) if kitti.is_file() else camera
    depth_camera = _camera_near(depth.parent, root, _DEPTH_CAMERAS)
    file = depth.with_name(f"{depth.stem}_mask.npy")  # of DIODE
    mask = file if file.is_file() else None
    scene, part = name.rpartition("/")[0], name.partition("/")[0]
    split = part if part in _PARTS else ""
    return Pair(name, scene, split, image, depth, camera, depth_camera, mask=mask)


def _nearest_in_time(images: Mapping[str, Path], depths: Mapping[str, Path]) -> dict[str, str]:
    """The depth that is nearest in time to each image, and the image to it; {} without stamps."""
    if not all(map(_TIME.fullmatch, (*images, *depths))):
        return {}
    stamps = [sorted(names, key=float) for names in (images, depths)]
    image_s, depth_s = (np.array(names, np.float64) for names in stamps)
    # In the middle of two, the earlier is the nearest.
    depth_of = np.searchsorted((depth_s[1:] + depth_s[:-1]) / 2, image_s)
    image_of = np.searchsorted((image_s[1:] + image_s[:-1]) / 2, depth_s)
    is_near = np.abs(depth_s[depth_of] - image_s) <= _MOST_APART_S
    mutual = np.flatnonzero(is_near & (image_of[depth_of] == np.arange(len(image_s))))
    return {stamps[0][i]: stamps[1][depth_of[i]] for i in mutual}


def _listed(table: Path) -> Listing:
    """Pairs of a list: image, depth and focal length, as of BTS; time and file of each, as of TUM.

    Paths are relative to the list's folder, also with a slash before them; depth may be ``None``.
    """
    pairs, is_timed = dict[str, Pair](), False
    for line in read_bytes(table).decode("utf-8-sig", "replace").splitlines():
        words = line.partition("#")[0].split()
        if len(words) > 3:  # noqa: PLR2004 - image and depth in either order
            words, is_timed = sorted(words[1:4:2], key=lambda word: "depth" in word.lower()), True
        if len(words) == 1:
            raise DatasetError(f"{table}: {line!r} is not IMAGE DEPTH FOCAL_PX")
        if not words or words[1] == "None":
            continue
        image, depth = (table.parent / word.lstrip("/") for word in words[:2])
        path = image.with_suffix("").relative_to(table.parent)
        pair = _pair(table.parent, path.name if is_timed else path.as_posix(), image, depth)
        try:
            camera = Intrinsics(float(words[2])) if words[2:] else pair.camera
        except (UsageError, ValueError):
            message = f"{table}: {words[2]!r} is no focal length in pixels"
            raise DatasetError(message) from None
        pair = replace(pair, camera=camera)
        if pairs.setdefault(pair.id, pair) != pair:
            raise DatasetError(f"{table} lists {pair.id} twice")
    if is_timed:
        return Listing(tuple(pairs.values()), f"TUM RGB-D, by {table.name}", _TUM_UNITS)
    return Listing(tuple(pairs.values()), f"pairs of {table.name}")


@lru_cache
def _camera_near(folder: Path, root: Path, names: tuple[str, ...]) -> Intrinsics:
    """The camera of a file in a folder or one above it, up to ``root``."""
    for name in names:
        if (folder / name).is_file():
            return read_calibration(folder / name)
    return UNKNOWN_CAMERA if folder == root else _camera_near(folder.parent, root, names)
