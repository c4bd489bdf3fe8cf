"""What depth loses in pictures whose light above 1 is clipped, on NYU Depth v2's val split.

Pictures are decoded to linear light, multiplied, clipped to 1, and encoded again. Printed is, by
the share of clipped pixels (in the colour that has most of them), how much depth differs from that
of the picture as it was, and abs_rel of both.
Run: ``python benchmarks/clipped_light.py --data NYU [--model default] [--limit N]``
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np

import depthcli
from depthcli.datasets.base import SplitName
from depthcli.datasets.nyu import open_nyu
from depthcli.evaluation.task import plan_nyu
from depthcli.io.exr.image import encode

STOPS = (0.25, 0.5, 1, 1.5, 2, 2.5, 3)
SHARES = (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model")
    parser.add_argument("--limit", type=int)
    options = parser.parse_args()
    task = plan_nyu(open_nyu(options.data), SplitName.VAL, options.limit)
    pipeline = depthcli.load(options.model, provider="cpu")
    rows = []
    for i in task.test:
        picture = task.dataset.image(i).astype(np.float32) / np.float32(255)
        linear = np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)
        true_m = task.dataset.depth_m(i)
        known = true_m > 0
        depth_m = pipeline.predict(depthcli.Frame(picture)).depth.values
        before = np.abs(depth_m[known] / true_m[known] - 1).mean()
        for stops in STOPS:
            clipped = linear.astype(np.float32)
            share = encode(clipped, exposure=stops) / known.size
            found_m = pipeline.predict(depthcli.Frame(clipped)).depth.values
            after = np.abs(found_m[known] / true_m[known] - 1).mean()
            rows.append((share, np.abs(found_m / depth_m - 1).mean(), before, after))
    shares, *scores = np.transpose(rows)
    print("clipped      pictures  depth differs  abs_rel  was")
    for low, high in pairwise(SHARES):
        chosen = (shares >= low) & (shares < high)
        if chosen.any():
            differs, before, after = (score[chosen].mean() for score in scores)
            words = f"{100 * low:3.0f} to {100 * high:3.0f} %  {chosen.sum():8}"
            print(f"{words}  {100 * differs:11.1f} %  {after:7.3f}  {before:.3f}")


if __name__ == "__main__":
    main()
