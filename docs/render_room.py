"""Render docs/room.jpg: a furnished room, ray cast with numpy, with its true depth beside it.

Run ``python docs/render_room.py`` to make the picture again. It also prints the range of the true
depth, along the camera axis, so that a prediction can be held against it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

WIDTH, HEIGHT = 640, 480
FOCAL_PX = 518.86  # the NYU Kinect's
EYE = np.array([-0.3, 1.45, 0.0])
PITCH_RAD = 0.16
LAMP = np.array([0.4, 2.35, 1.9])
SUPERSAMPLE = 2
Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned box in metres: x right, y up, z ahead; ``inside`` makes it a room."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    rgb: tuple[float, float, float]
    pattern: str = "plain"
    inside: bool = False


SCENE = (
    Box((-2.1, 0.0, -0.5), (1.9, 2.5, 4.3), (0.86, 0.83, 0.76), "room", inside=True),
    Box((-2.1, 0.0, 2.2), (-0.5, 0.42, 4.2), (0.50, 0.35, 0.24)),  # bed
    Box((-2.05, 0.42, 2.25), (-0.55, 0.60, 4.15), (0.62, 0.68, 0.80), "cloth"),
    Box((-1.95, 0.60, 3.65), (-0.75, 0.76, 4.10), (0.95, 0.94, 0.90)),  # pillow
    Box((0.95, 0.0, 3.65), (1.85, 1.95, 4.3), (0.45, 0.30, 0.19), "wood"),  # cabinet
    Box((1.05, 1.05, 3.62), (1.37, 1.85, 3.66), (0.55, 0.38, 0.25), "wood"),
    Box((1.43, 1.05, 3.62), (1.75, 1.85, 3.66), (0.55, 0.38, 0.25), "wood"),
    Box((0.75, 0.68, 1.85), (1.75, 0.74, 2.75), (0.60, 0.42, 0.27), "wood"),  # table
    Box((0.80, 0.0, 1.90), (0.86, 0.68, 1.96), (0.40, 0.28, 0.18)),
    Box((1.64, 0.0, 1.90), (1.70, 0.68, 1.96), (0.40, 0.28, 0.18)),
    Box((0.80, 0.0, 2.64), (0.86, 0.68, 2.70), (0.40, 0.28, 0.18)),
    Box((1.64, 0.0, 2.64), (1.70, 0.68, 2.70), (0.40, 0.28, 0.18)),
    Box((1.15, 0.74, 2.20), (1.45, 0.80, 2.42), (0.70, 0.20, 0.16)),  # book
    Box((1.50, 0.74, 2.45), (1.60, 0.96, 2.55), (0.85, 0.86, 0.88)),  # cup
    Box((-0.35, 1.05, 4.27), (0.65, 2.05, 4.30), (0.93, 0.95, 1.00), "window"),
    Box((-0.42, 0.98, 4.24), (0.72, 1.05, 4.30), (0.97, 0.97, 0.97)),
    Box((-0.25, 0.0, 1.3), (0.55, 0.012, 2.9), (0.55, 0.22, 0.20), "cloth"),  # rug
)


def render() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """The room as (480, 640, 3) RGB uint8 and its depth (480, 640) float32 in metres."""
    rays, axis = camera_rays()
    distance, box, normal = nearest(EYE, rays)
    points = EYE + rays * distance[..., None]
    colour = np.zeros_like(rays)
    for number, item in enumerate(SCENE):
        colour[box == number] = albedo(item, points[box == number], normal[box == number])
    to_lamp = LAMP - points
    reach = np.linalg.norm(to_lamp, axis=-1)
    to_lamp /= reach[..., None]
    blocked, _, _ = nearest(points + normal * 1e-3, to_lamp)
    lit = np.clip((normal * to_lamp).sum(-1), 0, None) * (blocked > reach - 0.02)
    light = 0.34 + 0.10 * normal[..., 1] + 1.9 * lit / (0.6 + reach**2)
    glowing = np.isin(box, [i for i, item in enumerate(SCENE) if item.pattern == "window"])
    image = np.where(glowing[..., None], colour, colour * light[..., None])
    image = np.clip(image, 0, 1) ** (1 / 1.9)
    image += np.random.default_rng(0).normal(0, 0.012, image.shape)
    small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    depth_m = (distance * (rays @ axis))[SUPERSAMPLE // 2 :: SUPERSAMPLE, ::SUPERSAMPLE]
    return np.rint(np.clip(small, 0, 1) * 255).astype(np.uint8), depth_m.astype(np.float32)


def camera_rays() -> tuple[Array, Array]:
    """Unit rays (H, W, 3) of the supersampled picture, and the camera axis (3,)."""
    columns = (np.arange(WIDTH * SUPERSAMPLE) + 0.5) / SUPERSAMPLE - WIDTH / 2
    rows = (np.arange(HEIGHT * SUPERSAMPLE) + 0.5) / SUPERSAMPLE - HEIGHT / 2
    x, y = np.meshgrid(columns / FOCAL_PX, -rows / FOCAL_PX)
    cos, sin = np.cos(PITCH_RAD), np.sin(PITCH_RAD)
    rays = np.stack([x, y * cos - sin, y * sin + cos], -1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    return rays, np.array([0.0, -sin, cos])


def nearest(origin: Array, rays: Array) -> tuple[Array, npt.NDArray[np.int64], Array]:
    """Distance, number and outward normal of the first box that each ray meets."""
    best = np.full(rays.shape[:-1], np.inf)
    number = np.zeros(best.shape, np.int64)
    normal = np.zeros(rays.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, item in enumerate(SCENE):
            to_low = (np.array(item.low) - origin) / rays
            to_high = (np.array(item.high) - origin) / rays
            enter, leave = np.minimum(to_low, to_high), np.maximum(to_low, to_high)
            first, last = enter.max(-1), leave.min(-1)
            distance = last if item.inside else first
            face = leave.argmin(-1) if item.inside else enter.argmax(-1)
            hit = (last > np.maximum(first, 0)) & (distance > 1e-6) & (distance < best)
            best[hit], number[hit] = distance[hit], i
            axis = np.eye(3)[face[hit]]
            normal[hit] = -axis * np.sign(rays[hit])
    return best, number, normal


def albedo(item: Box, points: Array, normal: Array) -> Array:
    """Colour (N, 3) of points on a box."""
    colour = np.tile(np.array(item.rgb), (len(points), 1))
    x, y, z = points.T
    if item.pattern == "room":
        floor = normal[:, 1] > 0.5
        plank = 0.9 + 0.1 * np.sin(np.floor(x / 0.16) * 12.9) + 0.04 * np.sin(z * 9 + x * 70)
        colour[floor] = np.array([0.52, 0.36, 0.22]) * plank[floor, None]
        colour[floor & (np.mod(x, 0.16) < 0.006)] *= 0.6
        colour[(normal[:, 1] > -0.5) & ~floor & (y < 0.09)] = (0.95, 0.95, 0.93)
    elif item.pattern == "wood":
        colour *= (0.92 + 0.08 * np.sin(y * 45 + np.sin(x * 9) * 2))[:, None]
    elif item.pattern == "cloth":
        colour *= (0.9 + 0.1 * np.sign(np.sin(x * 28) * np.sin(z * 28)))[:, None]
    elif item.pattern == "window":
        bar = (np.abs(x - 0.15) < 0.025) | (np.abs(y - 1.55) < 0.025)
        colour[bar] = (0.75, 0.75, 0.75)
    return colour


def main() -> None:
    """Write the picture and say how deep it is."""
    parser = argparse.ArgumentParser(description="Render the room and print its true depth.")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).with_name("room.jpg"),
        help="Default: %(default)s, which is replaced.",
    )
    target = parser.parse_args().out
    image, depth_m = render()
    quality = (cv2.IMWRITE_JPEG_QUALITY, 92)
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), quality)
    target.write_bytes(data.tobytes())
    low, median, high = depth_m.min(), np.median(depth_m), depth_m.max()
    print(f"{target}: true depth min {low:.3f}, median {median:.3f}, max {high:.3f} m")


if __name__ == "__main__":
    main()
