"""How close depth comes to the truth after a fit to few or many known points, on held-out pairs.

For each picture of NYU Depth v2, points of its true depth are drawn at random, with an error of
2 %; in the second table, each is wrong with a probability of one quarter: at 1.2 to 3 times its
depth, as seen past an edge. Printed is abs_rel over the whole picture, mean of pictures and draws,
of the model's depth, of the fit of ``--anchors``, of the same if the errors of all points were
independent, of the scale alone (least squares), and of scale and shift by least squares; and the
share of draws for which a fit fails, if any do. Points are anywhere in the picture, in a square of
170 pixels, or in a row.
Run: ``python benchmarks/anchors.py --data NYU [--model default] [--split val] [--draws 3]
[--where picture|square|row] [--counts 20,1000]``
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import depthcli
from depthcli.core.anchors import (
    ERROR_SD,
    ROBUST_FROM,
    SHIFT_SD,
    AnchorPoints,
    Pairs,
    fit_anchors,
    least_squares,
    robust,
)
from depthcli.core.options import Detail, Upsampling
from depthcli.datasets.base import SplitName
from depthcli.datasets.nyu import open_nyu
from depthcli.errors import UsageError
from depthcli.evaluation.task import plan_nyu

if TYPE_CHECKING:
    import numpy.typing as npt

    from depthcli.core.types import DepthMap

    FloatArray = npt.NDArray[np.float64]

COUNTS = (1, 2, 3, 5, 9, 10, 20, 100, 1000)
DEPTH_M = 0.4, 10.0
FITS = "model", "--anchors", "independent", "scale", "scale and shift"
SQUARE_PX = 170


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model")
    parser.add_argument("--split", type=SplitName, default=SplitName.VAL)
    parser.add_argument("--limit", type=int)
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--where", choices=("picture", "square", "row"), default="picture")
    parser.add_argument("--counts", default=",".join(map(str, COUNTS)))
    options = parser.parse_args()
    task = plan_nyu(open_nyu(options.data), options.split, options.limit)
    pipeline = depthcli.load(options.model, provider="cpu", detail=Detail(Upsampling.BILINEAR))
    maps = [
        (pipeline.predict(depthcli.Frame(task.dataset.image(i))).depth, task.dataset.depth_m(i))
        for i in task.test
    ]
    for share_wrong in (0.0, 0.25):
        print(f"{100 * share_wrong:.0f} % of the points wrong")
        print("points  " + "".join(f"{name:18}" for name in FITS))
        for count in map(int, options.counts.split(",")):
            random = np.random.default_rng(count)
            rows = [
                errors(depth, true_m, drawn(true_m, options.where, count, share_wrong, random))
                for depth, true_m in maps
                for _ in range(options.draws)
            ]
            print(f"{count:<6}  " + "".join(map(_words, np.transpose(rows))), flush=True)


def drawn(
    true_m: npt.NDArray[np.float32],
    where: str,
    count: int,
    share_wrong: float,
    random: np.random.Generator,
) -> AnchorPoints:
    """Points of a map at random, with errors."""
    height, width = true_m.shape
    rows = {"picture": height, "square": SQUARE_PX, "row": 2}[where]
    columns = SQUARE_PX if where == "square" else width
    top, left = random.integers(0, (height - rows + 1, width - columns + 1))
    part = true_m[top : top + rows, left : left + columns]
    chosen = random.choice(np.flatnonzero(part > 0), count, replace=False)
    y, x = np.unravel_index(chosen, part.shape)
    y, x = y + top, x + left
    seen_m = true_m[y, x] * random.normal(1, 0.02, count)
    is_wrong = random.random(count) < share_wrong
    seen_m[is_wrong] *= random.uniform(1.2, 3, is_wrong.sum())
    return AnchorPoints.of_table(np.stack([x, y, seen_m], axis=1))


def errors(depth: DepthMap, true_m: npt.NDArray[np.float32], points: AnchorPoints) -> FloatArray:
    """abs_rel of each of FITS: (5,) float64, NaN if a fit fails."""
    values, wanted = depth.values[points.y, points.x].astype(np.float64), points.depth_m
    pairs = Pairs(values, wanted, values * np.median(wanted / values), ERROR_SD, SHIFT_SD)
    independent = robust(pairs)[0] if len(values) >= ROBUST_FROM else least_squares(pairs)
    lines = [(1.0, 0.0), independent, (float(values @ wanted / (values @ values)), 0.0)]
    if len(values) > 1 and np.ptp(values) > 0:
        lines.append(tuple(np.polyfit(values, wanted, 1)))
    plain = [
        abs_rel(depth.values * scale + shift, true_m) if scale > 0 else np.nan
        for scale, shift in lines
    ]
    try:
        fitted = abs_rel(fit_anchors(depth, points).values, true_m)
    except UsageError:
        fitted = np.nan
    return np.array([plain[0], fitted, *plain[1:], *[np.nan] * (len(FITS) - 1 - len(plain))])


def abs_rel(depth_m: npt.NDArray[np.float32], true_m: npt.NDArray[np.float32]) -> float:
    """Mean of |predicted - true| ÷ true; pixels without depth count as the least depth."""
    known = true_m > 0
    clipped_m = np.nan_to_num(depth_m, nan=DEPTH_M[0])[known].clip(*DEPTH_M)
    return float(np.abs(clipped_m / true_m[known] - 1).mean())


def _words(scores: FloatArray) -> str:
    failed = np.isnan(scores).mean()
    if failed == 1:
        return f"{'-':18}"
    words = f"{np.nanmean(scores):.3f}" + (f" ({100 * failed:.1f} % fail)" if failed else "")
    return f"{words:18}"


if __name__ == "__main__":
    main()
