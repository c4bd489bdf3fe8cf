"""A checksum of a data set by which a copy of it is recognized, without reading its pictures."""

from depthcli.core import fingerprint
from depthcli.datasets.base import DepthDataset, HasFiles, HasFocalLengths


def data_fingerprint(dataset: DepthDataset) -> str:
    """Checksum of ids, focal lengths and file sizes in bytes; not of the folder's path.

    Of a data set that is not made of image files, such as a .mat file, it has no sizes.

    Raises:
        OSError: a file is missing.
    """
    focal_px = dataset.focal_px if isinstance(dataset, HasFocalLengths) else ()
    sizes: list[list[int]] = []
    if isinstance(dataset, HasFiles):
        files = map(dataset.files, range(len(dataset)))
        sizes = [[file.stat().st_size for file in pair] for pair in files]
    return fingerprint.fingerprint(list(dataset.ids), list(focal_px), sizes)
