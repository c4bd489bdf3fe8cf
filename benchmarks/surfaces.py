"""How rough surfaces are that should be smooth, and how many points hang between near and far.

``roughness``: the angle between the normal of each pixel and the mean of those of the 15 × 15
pixels around it, in degrees: mean, and median of an image, both averaged over every third
validation image of NYU Depth v2. Less is not better where edges go, too: see ``eval --boundary``.

``points off any surface``: more than 10 cm off the depth of every pixel within 4 pixels, of true
depth that was reduced to 256×192 and upsampled: their share of all points and of those that
``view`` keeps, and the share of the others that it leaves out; means over the same images.

Run: ``python benchmarks/surfaces.py NYU [--model default ...] [--upsample guided]``
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt
from tools import parse_options

import depthcli
from depthcli.core.imageops import resize_area, upsample_guided
from depthcli.core.surface import is_flying, surface_of
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.evaluation.task import plan_nyu

if TYPE_CHECKING:
    Floats = npt.NDArray[np.float32]

EVERY = 3
AROUND_PX = 15
FOCAL_PX = 518.86
REACH_PX = 4
OFF_M = 0.1


def roughness_deg(normals: Floats) -> Floats:
    """Angle between each normal (H, W, 3) and the mean of those around it, (H, W)."""
    around = cv2.blur(normals, (AROUND_PX, AROUND_PX))
    around /= np.linalg.norm(around, axis=2, keepdims=True)
    return np.asarray(np.degrees(np.arccos((normals * around).sum(2).clip(-1, 1))))


def off_surface(depth_m: Floats, true_m: Floats) -> npt.NDArray[np.bool_]:
    """Where depth is more than ``OFF_M`` off that of every pixel near; (H, W) bool."""
    height, width = true_m.shape
    around = np.pad(true_m, REACH_PX, mode="edge")
    nearest_m = np.full(depth_m.shape, np.inf, np.float32)
    for y, x in np.ndindex(2 * REACH_PX + 1, 2 * REACH_PX + 1):
        np.fmin(nearest_m, abs(depth_m - around[y : y + height, x : x + width]), out=nearest_m)
    return nearest_m > OFF_M


def shares(pixels: npt.NDArray[np.uint8], true_m: Floats) -> tuple[float, float, float]:
    """Shares of points off a surface: of all, of those that are left; and of others that go."""
    is_hole = true_m <= 0
    true_m = np.where(is_hole, true_m.max(), true_m)
    counted = cv2.dilate(is_hole.astype(np.uint8), np.ones((4 * REACH_PX + 1,) * 2, np.uint8)) == 0
    depth_m = upsample_guided(resize_area(true_m, 256, 192), depthcli.Frame(pixels), in_log=True)
    is_off = off_surface(depth_m, true_m)[counted]
    gone = is_flying(depth_m, FOCAL_PX)[counted]
    return float(is_off.mean()), float(is_off[~gone].mean()), float(gone[~is_off].mean())


def main() -> None:
    """Print the roughness of each model, and the points of true depth."""
    options = parse_options(
        __doc__, "nyu", model=["default", "float", "fast"], upsample="guided", limit=int
    )
    task = plan_nyu(open_nyu(options.nyu), SplitName.VAL, options.limit)
    pairs = [(task.dataset.image(i), task.dataset.depth_m(i)) for i in task.test[::EVERY]]
    for name in options.model:
        detail = depthcli.UpsamplingOptions(upsampling=options.upsample)
        model = depthcli.load_model(name, provider="cpu", detail=detail)
        depths = [model.predict(pixels) for pixels, _ in pairs]
        angles = [roughness_deg(surface_of(each, each.focal_px).normals()) for each in depths]
        mean, median = np.mean([each.mean() for each in angles]), np.mean([*map(np.median, angles)])
        print(f"{name:20} roughness: mean {mean:5.2f}°  median {median:5.2f}°")
    before, after, lost = np.mean([shares(*pair) for pair in pairs], 0)
    print(f"points off any surface: {before:.2%} of all, {after:.2%} of those that are left")
    print(f"left out of the others: {lost:.2%}")


if __name__ == "__main__":
    main()
