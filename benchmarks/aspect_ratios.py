"""Metres of pictures of other shapes and focal lengths than a model learned, on held-out pairs.

Held-out pictures of NYU Depth v2 are cropped: to the shapes of other pictures, and around their
middle, as through a longer lens. Printed for each are the mean over pictures of the median of
predicted ÷ true depth, and abs_rel, with the true focal length given and without it. Then how the
depth that the network gives for its own camera follows the focal length, and what of that is due to
the size at which things appear: whole pictures, brought to other sizes of the network's input.
Run: ``python benchmarks/aspect_ratios.py --data NYU [--model default] [--split val] [--limit N]``
"""

from __future__ import annotations

import argparse
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

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


class Fit(NamedTuple):
    """How far a map is off.

    Attributes:
        ratio: median of predicted ÷ true depth.
        abs_rel: mean of |predicted - true| ÷ true.
    """

    ratio: float
    abs_rel: float

    @classmethod
    def of(cls, depth_m: npt.NDArray[np.float32], true_m: npt.NDArray[np.float32]) -> Fit:
        """Compare two maps of one size."""
        known = (true_m > DEPTH_M[0]) & (true_m < DEPTH_M[1])
        ratio = depth_m[known].clip(*DEPTH_M) / true_m[known]
        return cls(float(np.median(ratio)), float(np.abs(ratio - 1).mean()))


class Crops(NamedTuple):
    """Middles of the pictures of a task, and a model to look at them.

    Attributes:
        task: the pictures.
        pipeline: the model.
    """

    task: EvalTask
    pipeline: depthcli.Pipeline

    def fits(self, width: int, height: int, focal_px: float | None) -> FloatArray:
        """(N, 2): ratio and abs_rel of each crop."""
        data = self.task.dataset
        return np.array(
            [
                Fit.of(
                    self.pipeline.predict(
                        depthcli.Frame(middle(data.image(i), width, height)),
                        Intrinsics(focal_px=focal_px),
                    ).depth.values,
                    middle(data.depth_m(i), width, height),
                )
                for i in self.task.test
            ]
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model")
    parser.add_argument("--split", type=SplitName, default=SplitName.VAL)
    parser.add_argument("--limit", type=int)
    options = parser.parse_args()
    task = plan_nyu(open_nyu(options.data), options.split, options.limit)
    plain = UpsamplingOptions(Upsampling.BILINEAR)
    pipeline = depthcli.load_model(options.model, provider="cpu", threads=1, detail=plain).pipeline
    crops = Crops(task, pipeline)
    print(f"{pipeline.card.name} {pipeline.card.version}, {len(task.test)} pictures")
    print_shapes(crops)
    print_zooms(crops)
    print_sizes(crops)


def print_shapes(crops: Crops) -> None:
    """The table of shapes."""
    print(f"{'':14} {'picture':>9}  with its focal length     without")
    for name, (width, height) in SHAPES.items():
        known, unknown = (crops.fits(width, height, focal) for focal in (FOCAL_PX, None))
        print(
            f"{name:14} {width:>4}×{height:<4}  {_words(known):24}  {_words(unknown)}", flush=True
        )


def print_zooms(crops: Crops) -> None:
    """The table of focal lengths, and the slope over them."""
    print(f"{'zoom':14} {'picture':>9}  with its focal length     without")
    log_ratios = []
    for zoom in ZOOMS:
        size = round(640 / zoom), round(480 / zoom)
        known, unknown = (crops.fits(*size, focal) for focal in (FOCAL_PX, None))
        log_ratios.append(-np.log(unknown[:, 0]))
        print(f"{zoom:<14} {size[0]:>4}×{size[1]:<4}  {_words(known):24}  {_words(unknown)}")
    _print_slope("log(true / predicted for the model's camera) on log(focal)", ZOOMS, log_ratios)


def print_sizes(crops: Crops) -> None:
    """The slope over the size at which things appear, with nothing cut off."""
    log_ratios = [
        -np.log(Crops(crops.task, resized(crops.pipeline, size)).fits(640, 480, None)[:, 0])
        for size in SIZES
    ]
    _print_slope("the same on log(size of the network's input), whole pictures", SIZES, log_ratios)


def resized(pipeline: depthcli.Pipeline, factor: float) -> depthcli.Pipeline:
    """The same network with an input of another size; its card then assumes the same picture."""
    session = copy(pipeline.session)
    spec = session.model.card.input
    width, height = round(spec.width * factor), round(spec.height * factor)
    card = replace(session.model.card, input=replace(spec, width=width, height=height))
    session.model = replace(session.model, card=card)
    return depthcli.Pipeline(session, pipeline.detail)


def _print_slope(name: str, over: Sequence[float], log_ratios: Sequence[FloatArray]) -> None:
    slopes, _ = np.polyfit(np.log(over), np.array(log_ratios), 1)
    error = slopes.std(ddof=1) / np.sqrt(len(slopes)) if len(slopes) > 1 else np.nan
    print(f"slope of {name}: {slopes.mean():.2f} ± {error:.2f}", flush=True)


def middle(values: npt.NDArray, width: int, height: int) -> npt.NDArray:
    """The middle ``width`` x ``height`` pixels of an array (H, W) or (H, W, C)."""
    top, left = (values.shape[0] - height) // 2, (values.shape[1] - width) // 2
    return np.ascontiguousarray(values[top : top + height, left : left + width])


def _words(fits: FloatArray) -> str:
    ratio, abs_rel = fits.mean(axis=0)
    return f"{ratio:.2f} ({abs_rel:.3f})"


if __name__ == "__main__":
    main()
