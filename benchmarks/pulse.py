"""How much depth pulses in videos with known motion, and whether smoothing blurs its edges.

Each sequence has 40 frames of 320×240 at 30 a second: crops that slide over, or zoom into, an image
of pairs that no model was trained on, with the jitter of a hand. The motion is known exactly, so a
pixel's place in the frame before is, too.

``temporal error``: mean of |(d_t(x) ÷ d_{t-1}(w(x))) ÷ (z_t(x) ÷ z_{t-1}(w(x))) - 1|, d the
predicted and z the true depth, w(x) where the point at x was in the frame before: the relative
change of depth from frame to frame that is not true. Points that were hidden or outside do not
count. ``abs_rel`` and ``edge F1`` are means over all and over every fourth frame. ``fast`` pans
4 pixels a frame, ``hand`` holds the camera.

Run: ``python benchmarks/pulse.py --data PAIRS [--model default] [--images 10]``; of NYU Depth v2,
they are validation images
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

import depthcli
from depthcli.core.temporal import (
    ChangeDetector,
    Correction,
    Deflicker,
    Smoother,
    ema_decay,
    sample_cells,
    thumbnail,
)
from depthcli.core.types import Frame
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.datasets.nyu import is_nyu, open_nyu
from depthcli.lab.datasets.training_data import open_pairs
from depthcli.lab.evaluation.task import plan_nyu, plan_pairs
from depthcli.lab.metrics.boundary import boundary_scores

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

Floats = npt.NDArray[np.float32]
COUNT, SIZE, INTERVAL_S, SMOOTH_S = 40, (320, 240), 1 / 30, 0.2
ZOOM, NOISE = 1.006, 1.5
SAME_SURFACE = 0.03  # of depth


class Made(NamedTuple):
    """Frames with their true depth, and the place of each pixel in the frame before."""

    rgb: list[npt.NDArray[np.uint8]]
    depth_m: list[Floats]
    #: of each frame but the first: column, row and depth in metres there, (3, H, W)
    before: list[Floats]


def noisy(rgb: npt.NDArray[Any], random: np.random.Generator) -> npt.NDArray[np.uint8]:
    """The noise of a sensor, which is new in each frame."""
    noise = random.normal(0, NOISE, rgb.shape)
    return np.clip(np.rint(rgb + noise), 0, 255).astype(np.uint8)


def sequence(
    rgb: npt.NDArray[np.uint8], depth_m: Floats, step_px: float, zoom: float, seed: int
) -> Made:
    """Crops that slide over an image, or zoom into it; depth moves along."""
    random = np.random.default_rng(seed)
    height, width = rgb.shape[:2]
    scale = 0.8 * width / SIZE[0]
    smooth = cv2.GaussianBlur(rgb.astype(np.float32), (0, 0), 0.45 * scale)
    hand_px, views = np.zeros(2), []
    for i in range(COUNT):
        hand_px = 0.7 * hand_px + random.normal(0, 0.25, 2) * scale
        share = scale * zoom**-i
        x = (width - share * (SIZE[0] - 1)) / 2 + hand_px[0]
        x += step_px * (i - (COUNT - 1) / 2) * scale
        y = (height - share * (SIZE[1] - 1)) / 2 + hand_px[1]
        views.append(np.array([[share, 0, x], [0, share, y]], np.float32))
    inverse = cv2.WARP_INVERSE_MAP
    depths_m = [
        np.asarray(cv2.warpAffine(depth_m, v, SIZE, flags=cv2.INTER_NEAREST | inverse), np.float32)
        for v in views
    ]
    frames = [cv2.warpAffine(smooth, v, SIZE, flags=cv2.INTER_LINEAR | inverse) for v in views]
    rows, columns = np.indices(SIZE[::-1], np.float32)
    places = []
    for now, before, z in zip(views[1:], views, depths_m[1:], strict=False):
        x, y = now[0, 0] * columns + now[0, 2], now[1, 1] * rows + now[1, 2]
        there = (x - before[0, 2]) / before[0, 0], (y - before[1, 2]) / before[1, 1]
        places.append(np.stack([*there, z]).astype(np.float32))
    return Made([noisy(frame, random) for frame in frames], depths_m, places)


def temporal_error(logs: Sequence[Floats], made: Made) -> float:
    """The temporal error of a sequence, (H, W) logarithms of depth."""
    errors = []
    for i, (x, y, z) in enumerate(made.before, start=1):
        near, mean = (
            cv2.remap(made.depth_m[i - 1], x, y, how)
            for how in (cv2.INTER_NEAREST, cv2.INTER_LINEAR)
        )
        is_seen = (x >= 0) & (x <= SIZE[0] - 1) & (y >= 0) & (y <= SIZE[1] - 1)
        is_seen &= (made.depth_m[i] > 0) & (near > 0)
        is_seen &= (abs(near - z) < SAME_SURFACE * z) & (abs(mean - z) < SAME_SURFACE * z)
        change = logs[i] - cv2.remap(logs[i - 1], x, y, cv2.INTER_LINEAR)
        true = np.log(made.depth_m[i], where=is_seen, out=np.zeros_like(z)) - np.log(z)
        errors.append(np.abs(np.expm1(change - true))[is_seen])
    return float(np.concatenate(errors).mean())


def scores(logs: Sequence[Floats], made: Made) -> tuple[float, float, float]:
    """Temporal error, abs_rel and edge F1."""
    errors = [
        np.mean(np.abs(np.exp(log) - z)[z > 0] / z[z > 0])
        for log, z in zip(logs, made.depth_m, strict=True)
    ]
    edges = [
        boundary_scores(np.where(z > 0, z, 1), np.exp(log), z > 0).edge_f1
        for log, z in zip(logs[::4], made.depth_m[::4], strict=True)
    ]
    return temporal_error(logs, made), float(np.mean(errors)), float(np.nanmean(edges))


def smoothed(
    logs: Sequence[Floats], rgb: Sequence[npt.NDArray[np.uint8]], look_ahead: int | None
) -> list[Floats]:
    """Depth as ``--smooth 0.2`` writes it; None for no correction, as up to 0.18.0."""
    changes, smoother = ChangeDetector(), Smoother()
    small = [thumbnail(pixels) for pixels in rgb]
    steps = [changes.step(image) for image in small]
    decay = ema_decay(INTERVAL_S, SMOOTH_S)
    if look_ahead is None:
        rows, columns = (size // 3 for size in small[0].shape)
        nothing = np.zeros((rows, columns), np.float32)
        steady = [Correction(nothing, nothing + 1)] * len(logs)
    else:
        deflicker, steady = Deflicker(look_ahead), []
        for image, log, change in zip(small, logs, steps, strict=True):
            cells = sample_cells(log, image.shape)
            steady += deflicker.step(image, cells, decay, is_cut=change.is_cut)
        steady += deflicker.finish()
    frames = zip(logs, steps, steady, strict=True)
    return [smoother.step(log, change, frame, decay) for log, change, frame in frames]


METHODS: dict[str, Callable[[list[Floats], Made], list[Floats]]] = {
    "none": lambda logs, _: logs,
    "0.18.0": lambda logs, made: smoothed(logs, made.rgb, None),
    "look-ahead 0": lambda logs, made: smoothed(logs, made.rgb, 0),
    "look-ahead 4": lambda logs, made: smoothed(logs, made.rgb, 4),
    "look-ahead 8": lambda logs, made: smoothed(logs, made.rgb, 8),
}


def sequences(data: Path, images: int) -> Iterator[tuple[str, Made]]:
    """Each sequence with its kind."""
    if is_nyu(data):
        task = plan_nyu(open_nyu(data), SplitName.VAL, images)
    else:
        task = plan_pairs(open_pairs(data), data.name, images)
    for number, i in enumerate(task.test):
        pair = task.dataset.image(i), task.dataset.depth_m(i)
        zoom = ZOOM if number % 3 == 2 else 1
        step_px = 1.5 if zoom == 1 else 0
        yield "photographs", sequence(*pair, step_px, zoom, number)
        if number % 3 == 0:
            yield "fast", sequence(*pair, 4, 1, number)
            yield "hand", sequence(*pair, 0, 1, number)


def main() -> None:
    """Print the mean of each kind of sequence, and the time that smoothing takes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model", default="default")
    parser.add_argument("--images", type=int, default=10)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pipeline = depthcli.load_model(options.model, threads=1).pipeline
    scores_of: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    seconds: dict[str, float] = defaultdict(float)
    frames = 0
    for kind, video in sequences(options.data, options.images):
        logs = [np.log(pipeline.predict(Frame(pixels)).depth.values) for pixels in video.rgb]
        frames += len(logs)
        for name, method in METHODS.items():
            start = time.perf_counter()
            steady = method(logs, video)
            seconds[name] += time.perf_counter() - start
            scores_of[kind, name].append(scores(steady, video))
    for (kind, name), each in scores_of.items():
        error, abs_rel, edges = np.mean(each, axis=0)
        ratio = error / np.mean(scores_of[kind, "0.18.0"], axis=0)[0]
        print(
            f"{kind:12} {name:13} temporal error {error:.3%} ({ratio:.2f})"
            f"  abs_rel {abs_rel:.4f}  edge F1 {edges:.4f}"
        )
    for name, total in seconds.items():
        print(f"{name:13} {total / frames * 1e3:.1f} ms a frame")


if __name__ == "__main__":
    main()
