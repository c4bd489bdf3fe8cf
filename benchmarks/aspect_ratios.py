"""Metres of pictures of other shapes and focal lengths than a model learned, on held-out pairs.

Held-out pictures of NYU Depth v2 are cropped: to the shapes of other pictures, and around their
middle, as through a longer lens. Printed for each are the mean over pictures of the median of
predicted ÷ true depth, and abs_rel, with the true focal length given and without it. Then how the
depth that the network gives for its own camera follows the focal length, and what of that is due to
the size at which things appear: whole pictures, brought to other sizes of the network's input.
Run: ``python benchmarks/aspect_ratios.py --data NYU [--model default] [--split val] [--limit N]``
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from tools import parse_options

import depthcli
from depthcli.core.camera import Intrinsics
from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.evaluation.task import plan_nyu

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from depthcli.lab.evaluation.task import EvalTask

    FloatArray = npt.NDArray[np.float64]

FOCAL_PX = 518.86
"""Of NYU Depth v2's pictures, 640 x 480."""
DEPTH_M = 1e-3, 10.0
SHAPES = {
    "4:3": (640, 480),
    "portrait 3:4": (360, 480),
    "portrait 9:16": (270, 480),
    "square": (480, 480),
    "16:9": (640, 360),
    "21:9": (640, 274),
    "3:1": (640, 214),
    "4:1": (640, 160),
}
ZOOMS = (1.0, 1.125, 1.25, 1.375, 1.5, 1.75, 2.0)
SIZES = (2 / 3, 5 / 6, 1.0, 7 / 6, 4 / 3, 1.5)


class Crops(NamedTuple):
    """Middles of the pictures of a task, and a model to look at them."""

    task: EvalTask
    pipeline: depthcli.Pipeline

    def fits(self, width: int, height: int, focal_px: float | None) -> FloatArray:
        """(N, 2): of each crop the median of predicted ÷ true depth, and abs_rel."""
        data, rows = self.task.dataset, []
        for i in self.task.test:
            frame = depthcli.Frame(middle(data.image(i), width, height))
            depth_m = self.pipeline.predict(frame, Intrinsics(focal_px=focal_px)).depth.values
            true_m = middle(data.depth_m(i), width, height)
            counted = (true_m > DEPTH_M[0]) & (true_m < DEPTH_M[1])
            ratio = depth_m[counted].clip(*DEPTH_M) / true_m[counted]
            rows.append((np.median(ratio), np.abs(ratio - 1).mean()))
        return np.array(rows)

    def print_fits(self, name: object, width: int, height: int) -> FloatArray:
        """Print a line of a table; the fits without focal length."""
        with_focal, without = (self.fits(width, height, focal) for focal in (FOCAL_PX, None))
        words = ["{:.2f} ({:.3f})".format(*fits.mean(axis=0)) for fits in (with_focal, without)]
        print(f"{name!s:14} {width:>4}×{height:<4}  {words[0]:24}  {words[1]}", flush=True)
        return without


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, data=Path, model="default", split=SplitName.VAL, limit=int)
    task = plan_nyu(open_nyu(options.data), options.split, options.limit)
    plain = UpsamplingOptions(Upsampling.BILINEAR)
    pipeline = depthcli.load_model(options.model, provider="cpu", threads=1, detail=plain).pipeline
    crops = Crops(task, pipeline)
    print(f"{pipeline.card.name} {pipeline.card.version}, {len(task.test)} pictures")
    print(f"{'':14} {'picture':>9}  with its focal length     without")
    for name, size in SHAPES.items():
        crops.print_fits(name, *size)
    print("zoom")
    zoomed = [crops.print_fits(zoom, round(640 / zoom), round(480 / zoom)) for zoom in ZOOMS]
    print_slope("log(true / predicted for the model's camera) on log(focal)", ZOOMS, zoomed)
    whole = [Crops(task, resized(pipeline, size)).fits(640, 480, None) for size in SIZES]
    print_slope("the same on log(size of the network's input), whole pictures", SIZES, whole)


def resized(pipeline: depthcli.Pipeline, factor: float) -> depthcli.Pipeline:
    """The same network with an input of another size; its card then assumes the same picture."""
    session = copy(pipeline.session)
    spec = session.model.card.input
    width, height = round(spec.width * factor), round(spec.height * factor)
    card = replace(session.model.card, input=replace(spec, width=width, height=height))
    session.model = replace(session.model, card=card)
    return depthcli.Pipeline(session, pipeline.detail)


def print_slope(name: str, over: Sequence[float], fits: Sequence[FloatArray]) -> None:
    """Print the slope of the logarithm of true ÷ predicted depth, and its standard error."""
    slopes, _ = np.polyfit(np.log(over), -np.log([each[:, 0] for each in fits]), 1)
    error = slopes.std(ddof=1) / np.sqrt(len(slopes)) if len(slopes) > 1 else np.nan
    print(f"slope of {name}: {slopes.mean():.2f} ± {error:.2f}", flush=True)


def middle(values: npt.NDArray, width: int, height: int) -> npt.NDArray:
    """The middle ``width`` x ``height`` pixels of an array (H, W) or (H, W, C)."""
    top, left = (values.shape[0] - height) // 2, (values.shape[1] - width) // 2
    return np.ascontiguousarray(values[top : top + height, left : left + width])


if __name__ == "__main__":
    main()
