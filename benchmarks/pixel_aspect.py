"""Depth of pictures with pixels that are not square, on the pairs of NYU Depth v2's val split.

Pictures are squeezed along one axis, as by an anamorphic lens. Printed is abs_rel, rmse and d1 of
their depth at the size of the ground truth, with the shape of the pixels stated and without.
Run: ``python benchmarks/pixel_aspect.py --data NYU [--model default] [--limit N]``
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

import depthcli
from depthcli.core.camera import Intrinsics, focal_px_of_hfov
from depthcli.core.imageops import resize_bilinear
from depthcli.datasets.base import SplitName
from depthcli.datasets.nyu import open_nyu
from depthcli.evaluation.task import plan_nyu

NYU_HFOV_DEG = 63.3
SQUEEZES = (1, 4 / 3, 2, 1 / 2)
"""Width by height of a pixel."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model")
    parser.add_argument("--limit", type=int)
    options = parser.parse_args()
    task = plan_nyu(open_nyu(options.data), SplitName.VAL, options.limit)
    pipeline = depthcli.load(options.model, provider="cpu")
    print("pixels  stated  abs_rel    rmse      d1")
    for aspect in SQUEEZES:
        for stated in (True, False) if aspect != 1 else (True,):
            rows = []
            for i in task.test:
                picture, true_m = task.dataset.image(i), task.dataset.depth_m(i)
                height, width = true_m.shape
                size = round(width / max(1, aspect)), round(height * min(1, aspect))
                pixels = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
                frame = depthcli.Frame(pixels, pixel_aspect=aspect if stated else 1.0)
                focal_px = focal_px_of_hfov(NYU_HFOV_DEG, size[0])
                depth_m = pipeline.predict(frame, Intrinsics(focal_px=focal_px)).depth.values
                known = true_m > 0
                found, truth = resize_bilinear(depth_m, width, height)[known], true_m[known]
                ratio = np.maximum(found / truth, truth / found)
                rmse = np.sqrt(np.square(found - truth).mean())
                rows.append((np.abs(found / truth - 1).mean(), rmse, (ratio < 1.25).mean()))
            abs_rel, rmse, d1 = np.mean(rows, 0)
            print(f"{aspect:6.2f}  {stated!s:6}  {abs_rel:7.4f}  {rmse:6.4f}  {d1:6.4f}")


if __name__ == "__main__":
    main()
