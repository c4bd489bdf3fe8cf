"""How much depth pulses in videos with known motion, and whether smoothing blurs its edges.

Each sequence has 40 frames of 320×240 at 30 a second: a hand-held camera turns, advances, moves
sideways or zooms in a rendered room; or the frame slides over, or zooms into, a photograph of NYU
Depth v2. The motion is known exactly, so a pixel's place in the frame before is, too.

``temporal error``: mean of |(d_t(x) ÷ d_{t-1}(w(x))) ÷ (z_t(x) ÷ z_{t-1}(w(x))) - 1|, d the
predicted and z the true depth, w(x) where the point at x was in the frame before: the relative
change of depth from frame to frame that is not true. Points that were hidden or outside do not
count. ``abs_rel`` and ``edge F1`` are means over all and over every fourth frame. ``fast`` pans
4 pixels a frame over photographs, ``hand`` holds the camera.

Run: ``python benchmarks/pulse.py [--nyu NYU] [--model default] [--rooms 8] [--photographs 10]``
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
from depthcli.datasets.base import SplitName
from depthcli.datasets.nyu import open_nyu
from depthcli.datasets.rooms.render import (
    PinholeCamera,
    Renderer,
    RoomSettings,
    photograph,
    place_camera,
    room_focal_px,
)
from depthcli.datasets.rooms.room import make_room
from depthcli.datasets.rooms.solids import rotation
from depthcli.evaluation.task import plan_nyu
from depthcli.metrics.boundary import boundary_scores

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

Floats = npt.NDArray[np.float32]
COUNT, SIZE, INTERVAL_S, SMOOTH_S = 40, (320, 240), 1 / 30, 0.2
ZOOM, STEP_M, TURN_DEG, NOISE = 1.006, 0.012, 0.5, 1.5
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


def room_sequence(number: int, motion: str) -> Made:
    """A camera moving in a rendered room."""
    settings = RoomSettings(7, SIZE, (63.0, 63.0))
    random = np.random.default_rng([settings.seed, number, 1])
    room = make_room(random)
    solids = room.solids
    camera = place_camera(random, room, solids, room_focal_px(settings, number), SIZE)
    random = np.random.default_rng(number)
    cameras = [*moved(camera, motion, random)]
    rgb, depth_m = [], []
    for i, one in enumerate(cameras):
        bits = np.random.PCG64(number)
        renderer = Renderer(room, solids, one, np.random.Generator(bits))
        bits.advance(i << 40)  # other samples of the light, on the same textures
        view = renderer.view()
        rgb.append(noisy(photograph(view.light, np.random.default_rng(number)), random))
        depth_m.append(view.depth_m)
    pairs = zip(cameras[1:], cameras, depth_m[1:], strict=False)
    return Made(rgb, depth_m, [seen_before(*pair) for pair in pairs])


def moved(
    camera: PinholeCamera, motion: str, random: np.random.Generator
) -> Iterator[PinholeCamera]:
    """The cameras of a sequence, with the jitter of a hand."""
    hand_deg = np.zeros(2)
    sideways, _, ahead = camera.orientation.T
    for i in range(COUNT):
        hand_deg = 0.7 * hand_deg + random.normal(0, 0.06, 2)
        yaw_deg = hand_deg[0] + (TURN_DEG * i if motion == "pan" else 0)
        turn = rotation(yaw_deg, 1) @ rotation(hand_deg[1], 0)
        way_m = {"dolly": ahead, "truck": sideways}.get(motion, 0 * ahead) * STEP_M * i
        x, y, z = np.add(camera.eye, way_m)
        yield camera._replace(
            eye=(float(x), float(y), float(z)),
            orientation=(camera.orientation @ turn).astype(np.float32),
            focal_px=camera.focal_px * (ZOOM**i if motion == "zoom" else 1),
        )


def seen_before(now: PinholeCamera, before: PinholeCamera, depth_m: Floats) -> Floats:
    """Column, row and depth of each pixel's point for the camera before, (3, H, W)."""
    points = now.origin + now.rays() * depth_m.ravel()
    x, y, z = before.orientation.T @ (points - before.origin)
    z = np.maximum(z, 1e-6)
    columns = x / z * before.focal_px + before.width / 2 - 0.5
    rows = -y / z * before.focal_px + before.height / 2 - 0.5
    return np.stack([columns, rows, z]).reshape(3, *depth_m.shape).astype(np.float32)


def photograph_sequence(
    rgb: npt.NDArray[np.uint8], depth_m: Floats, step_px: float, zoom: float, seed: int
) -> Made:
    """A frame sliding over a photograph, or zooming into it; depth moves along."""
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
    found = []
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
        found.append(np.abs(np.expm1(change - true))[is_seen])
    return float(np.concatenate(found).mean())


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
    found = [changes.step(picture) for picture in small]
    decay = ema_decay(INTERVAL_S, SMOOTH_S)
    if look_ahead is None:
        rows, columns = (size // 3 for size in small[0].shape)
        nothing = np.zeros((rows, columns), np.float32)
        steady = [Correction(nothing, nothing + 1)] * len(logs)
    else:
        deflicker, steady = Deflicker(look_ahead), []
        for picture, log, change in zip(small, logs, found, strict=True):
            cells = sample_cells(log, picture.shape)
            steady += deflicker.step(picture, cells, decay, is_cut=change.is_cut)
        steady += deflicker.finish()
    frames = zip(logs, found, steady, strict=True)
    return [smoother.step(log, change, one, decay) for log, change, one in frames]


METHODS: dict[str, Callable[[list[Floats], Made], list[Floats]]] = {
    "none": lambda logs, _: logs,
    "0.18.0": lambda logs, made: smoothed(logs, made.rgb, None),
    "look-ahead 0": lambda logs, made: smoothed(logs, made.rgb, 0),
    "look-ahead 4": lambda logs, made: smoothed(logs, made.rgb, 4),
    "look-ahead 8": lambda logs, made: smoothed(logs, made.rgb, 8),
}


def sequences(rooms: int, nyu: Path | None, photographs: int) -> Iterator[tuple[str, Made]]:
    """Each sequence with its kind."""
    for number in range(rooms):
        motion = ("pan", "dolly", "truck", "zoom")[number % 4]
        yield "rooms", room_sequence(number, motion)
    if nyu is None:
        return
    task = plan_nyu(open_nyu(nyu), SplitName.VAL, photographs)
    for number, i in enumerate(task.test):
        picture = task.dataset.image(i), task.dataset.depth_m(i)
        zoom = ZOOM if number % 3 == 2 else 1
        step_px = 1.5 if zoom == 1 else 0
        yield "photographs", photograph_sequence(*picture, step_px, zoom, number)
        if number % 3 == 0:
            yield "fast", photograph_sequence(*picture, 4, 1, number)
            yield "hand", photograph_sequence(*picture, 0, 1, number)


def main() -> None:
    """Print the mean of each kind of sequence, and the time that smoothing takes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nyu", type=Path)
    parser.add_argument("--model", default="default")
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--photographs", type=int, default=10)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pipeline = depthcli.load_model(options.model, threads=1).pipeline
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    seconds: dict[str, float] = defaultdict(float)
    frames = 0
    for kind, made in sequences(options.rooms, options.nyu, options.photographs):
        logs = [np.log(pipeline.predict(Frame(pixels)).depth.values) for pixels in made.rgb]
        frames += len(logs)
        for name, method in METHODS.items():
            start = time.perf_counter()
            steady = method(logs, made)
            seconds[name] += time.perf_counter() - start
            found[kind, name].append(scores(steady, made))
    for (kind, name), each in found.items():
        error, abs_rel, edges = np.mean(each, axis=0)
        ratio = error / np.mean(found[kind, "0.18.0"], axis=0)[0]
        print(
            f"{kind:12} {name:13} temporal error {error:.3%} ({ratio:.2f})"
            f"  abs_rel {abs_rel:.4f}  edge F1 {edges:.4f}"
        )
    for name, total in seconds.items():
        print(f"{name:13} {total / frames * 1e3:.1f} ms a frame")


if __name__ == "__main__":
    main()
