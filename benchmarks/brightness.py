"""Whether depth copies brightness: correlations over the pairs of NYU Depth v2's val split.

Printed is, for each model, the mean over pictures of Pearson's correlation of its depth with V of
HSV and with the true depth, over the pixels of known depth; the first row is the true depth's own.
Run: ``python benchmarks/brightness.py --data NYU MODEL...``
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import depthcli
from depthcli.core.imageops import resize_bilinear
from depthcli.core.options import Detail, Upsampling
from depthcli.datasets.base import SplitName
from depthcli.datasets.nyu import open_nyu
from depthcli.evaluation.task import plan_nyu
from depthcli.inference.pipeline import load


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--limit", type=int)
    options = parser.parse_args()
    task = plan_nyu(open_nyu(options.data), SplitName.VAL, options.limit)
    plain = Detail(Upsampling.BILINEAR)  # guided upsampling copies edges of the picture
    pipelines = [load(path, provider="cpu", threads=1, detail=plain) for path in options.models]
    pictures = []
    for i in task.test:
        picture, true_m = task.dataset.image(i), task.dataset.depth_m(i)
        height, width = true_m.shape
        known, value = true_m > 0, picture.max(2).astype(np.float64)
        maps = [one.predict(depthcli.Frame(picture)).depth.values for one in pipelines]
        depths = [true_m, *(resize_bilinear(depth, width, height) for depth in maps)]
        pictures.append(
            [
                [np.corrcoef(depth[known], other[known])[0, 1] for other in (value, true_m)]
                for depth in depths
            ]
        )
    print(f"{'model':20} with V  with true depth")
    names = ["true depth", *(path.name for path in options.models)]
    for name, (with_value, with_truth) in zip(names, np.mean(pictures, 0), strict=True):
        print(f"{name:20} {with_value:6.2f}  {with_truth:15.2f}")


if __name__ == "__main__":
    main()
