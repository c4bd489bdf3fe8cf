"""The files of known depth, which :mod:`depthcli.known.sources` reads; free of numpy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.options import DepthEncoding
from depthcli.errors import InputError
from depthcli.io.formats.table import READABLE_SUFFIXES
from depthcli.io.storage.atomic import identity_of
from depthcli.io.storage.paths import path_of, safe_name

if TYPE_CHECKING:
    from pathlib import Path


CLOUDS = (".pcd", ".ply")  #: suffixes of point clouds alone
#: suffixes of files with known depth
SUFFIXES = (".csv", *CLOUDS, *(s for s in READABLE_SUFFIXES if s not in CLOUDS))
SELF = "self"  #: in place of a path, the depth that a phone stored within each image
_COLMAP = ("cameras", "images", "points3D")
_TOPIC = "topic:"  # of a bag, in place of a path
OUTPUT = ".depth"  #: end of the stems of the outputs of ``convert``
ALTERNATIVES = f"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"


@dataclass(frozen=True)
class KnownDepthFiles:
    """A file with known depth, a folder of such files or of COLMAP's, or the images themselves."""

    path: str  #: the file, the folder, ``SELF``, or a topic of bags, such as ``topic:/points``
    #: units per metre; None for what the file states: of integers millimetres, else metres
    scale: float | None = None
    kind: DepthEncoding | None = None  #: of the numbers in a map that states none; None for metres
    camera: Intrinsics = UNKNOWN_CAMERA  #: of distances along the ray and of disparity, as stated
    baseline_m: float | None = None  #: between the two cameras of disparity
    extrinsics: Path | None = None  #: pose of the axes of clouds in the camera; None for its own

    @cached_property
    def reconstruction(self) -> tuple[Path, ...]:
        """The files of a reconstruction by COLMAP in the folder; none if there is none."""
        for suffix in () if self.path == SELF else (".bin", ".txt"):
            folder = path_of(self.path)
            files = tuple(folder / f"{part}{suffix}" for part in _COLMAP)
            if all(file.is_file() for file in files):
                return files
        return ()

    @property
    def topic(self) -> str | None:
        """The topic of bags; None if there is none."""
        return self.path.removeprefix(_TOPIC) if self.path.startswith(_TOPIC) else None

    @property
    def is_by_image(self) -> bool:
        """Whether it is that of an image itself, or of its name."""
        return self.path == SELF or bool(self.topic or self.reconstruction)

    @property
    def may_be_clouds(self) -> bool:
        """Whether it is a point cloud, or a folder that may have some."""
        suffix = path_of(self.path).suffix.lower()
        is_map = suffix in SUFFIXES and suffix not in (*CLOUDS, ".bin")
        return bool(self.topic) or not (self.is_by_image or is_map)

    def file_for(self, name: str, *, shares_stem: bool = False, image: Path | None = None) -> Path:
        """The folder's file for an image.

        For ``a.jpg``, that is ``a.jpg.npy``, else ``a.jpg.depth.npy``, ``a.npy`` or
        ``a.depth.npy``.

        With ``shares_stem``, ``a.npy`` could be that of another image, such as ``a.png``. The
        image's own file is not its known depth, whatever its suffix.
        """
        folder = path_of(self.path)
        above, slash, last = name.rpartition("/")
        base = above + slash + (last.rpartition(".")[0] or last)
        files = _files(folder, name) or _files(folder, name + OUTPUT)
        if not files:
            files = _files(folder, base, image) or _files(folder, base + OUTPUT)
            if files and shares_stem:
                problem = f"{files[0]} may be the known depth of this or another {safe_name(base)}"
                raise InputError(problem, f"name it {safe_name(name)}{files[0].suffix}")
        if not files:
            raise InputError(
                f"{folder} has no known depth for it: {safe_name(base)} with {ALTERNATIVES}"
            )
        if len(files) > 1:
            raise InputError(f"{files[0]} and {files[1]} are both its known depth", "remove one")
        return files[0]


def _files(folder: Path, stem: str, image: Path | None = None) -> list[Path]:
    files = [file for suffix in SUFFIXES if (file := folder / (stem + suffix)).is_file()]
    return [file for file in files if image is None or identity_of(file) != identity_of(image)]
