"""How rough surfaces are that should be smooth: walls and floors with the texture of the image.

Figure of merit: the angle between the normal of each pixel and the mean of those of the 15 × 15
pixels around it, in degrees: mean, and median of an image, both averaged over every third
validation image of NYU Depth v2. Less is not better where edges go, too: see ``eval --boundary``.

Run: ``python benchmarks/smoothness.py NYU [--model default ...] [--upsample guided]``
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from tools import parse_options

import depthcli
from depthcli.core.surface import surface_of
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.evaluation.task import plan_nyu

AROUND_PX = 15
EVERY = 3


def roughness_deg(normals: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Angle between each normal (H, W, 3) and the mean of those around it, (H, W)."""
    around = cv2.blur(normals, (AROUND_PX, AROUND_PX))
    around /= np.linalg.norm(around, axis=2, keepdims=True)
    return np.asarray(np.degrees(np.arccos((normals * around).sum(2).clip(-1, 1))))


def main() -> None:
    """Print the mean and the median of each model."""
    options = parse_options(
        __doc__, "nyu", model=["default", "float", "fast"], upsample="guided", limit=int
    )
    task = plan_nyu(open_nyu(options.nyu), SplitName.VAL, options.limit)
    for name in options.model:
        detail = depthcli.UpsamplingOptions(upsampling=options.upsample)
        model = depthcli.load_model(name, provider="cpu", detail=detail)
        angles = []
        for pair in task.test[::EVERY]:
            depth = model.predict(task.dataset.image(pair))
            angles.append(roughness_deg(surface_of(depth, depth.focal_px).normals()))
        mean, median = np.mean([each.mean() for each in angles]), np.mean([*map(np.median, angles)])
        print(f"{name:20} mean {mean:5.2f}°  median {median:5.2f}°")


if __name__ == "__main__":
    main()
