"""The field of view of training pictures, before they are stretched to the network's input."""

from depthcli.core.camera import focal_px_of_hfov
from depthcli.datasets.base import DepthDataset, HasCamera, HasFocalLengths
from depthcli.datasets.training_data import NYU_ASPECT, NYU_HFOV_DEG


def tan_half_fov(dataset: DepthDataset, i: int, shape: tuple[int, ...]) -> tuple[float, float]:
    """Tangents of half the angles of view of picture ``i``, across and down, for square pixels.

    If its camera is not known, it is taken for the largest crop of one of NYU's pictures, in
    landscape or portrait, as predictions do (docs/cameras.md).

    Args:
        dataset: may know its camera, or the focal length of each picture.
        i: position of the picture.
        shape: height and width of the picture, or of its depth; further numbers are ignored.
    """
    height, width = shape[:2]
    long_px = max(width, height, NYU_ASPECT * min(width, height))
    focal_px = long_px * focal_px_of_hfov(NYU_HFOV_DEG, 1)
    if isinstance(dataset, HasFocalLengths) and dataset.focal_px:
        focal_px = dataset.focal_px[i]
    elif isinstance(dataset, HasCamera) and dataset.hfov_deg is not None:
        focal_px = focal_px_of_hfov(dataset.hfov_deg, width)
    return width / 2 / focal_px, height / 2 / focal_px
