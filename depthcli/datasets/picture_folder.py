"""A folder of pictures without depth, for methods that learn from pictures alone."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from depthcli.datasets.files import IMAGE_SUFFIXES, read_image_rgb
from depthcli.datasets.paired_folder import list_files
from depthcli.errors import DatasetError
from depthcli.io.listing.own_outputs import is_own_output


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
