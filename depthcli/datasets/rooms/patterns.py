"""Repeating patterns, between 0 and 1: wood, tiles, fabrics, prints."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating[Any]]
TILE_PX = 128


def _noise(random: np.random.Generator, across: int, down: int) -> Floats:
    """Smooth repeating noise in [0, 1], from a grid of ``across`` x ``down`` random values."""
    coarse = random.random((down, across), np.float32)
    coarse = np.pad(coarse, 2, mode="wrap")
    step_x, step_y = TILE_PX / across, TILE_PX / down
    size = (round(step_x * (across + 4)), round(step_y * (down + 4)))
    fine = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    x, y = round(step_x * 2), round(step_y * 2)
    return np.clip(fine[y : y + TILE_PX, x : x + TILE_PX], 0, 1)


def _clouds(random: np.random.Generator) -> Floats:
    return (4 * _noise(random, 4, 4) + 2 * _noise(random, 9, 9) + _noise(random, 32, 32)) / 7


def _tile_coordinates() -> tuple[Floats, Floats]:
    x, y = np.meshgrid(*2 * [(np.arange(TILE_PX, dtype=np.float32) + 0.5) / TILE_PX])
    return x, y


def _plaster(random: np.random.Generator) -> Floats:
    return 0.5 * _clouds(random) + 0.5 * _noise(random, 64, 64)


def _wood(random: np.random.Generator) -> Floats:
    x, _ = _tile_coordinates()
    rings = np.sin(2 * np.pi * (x * random.integers(2, 6) + 0.6 * _noise(random, 4, 2)))
    return 0.35 + 0.2 * rings + 0.45 * _noise(random, 64, 4)


def _planks(random: np.random.Generator) -> Floats:
    rows = int(random.integers(4, 9))
    x, y = _tile_coordinates()
    row = np.floor(x * rows).astype(int)
    shade = random.random((rows, 2), np.float32)
    along = y * 2 + 0.37 * row
    seam = (x * rows % 1 < rows / TILE_PX) | (along % 1 < 0.02)
    wood = 0.35 + 0.4 * shade[row, along.astype(int) % 2] + 0.25 * _noise(random, 64, 4)
    return np.where(seam, 0, wood)


def _tiles(random: np.random.Generator) -> Floats:
    across, down = int(random.integers(2, 6)), int(random.integers(2, 6))
    x, y = _tile_coordinates()
    shift = 0.5 * (np.floor(y * down) % 2) * random.integers(2)
    edge = np.minimum((x * across + shift) % 1 / across, y * down % 1 / down)
    joint = edge < random.uniform(0.01, 0.03)
    return np.where(joint, random.random() * 0.5, 0.75 + 0.25 * _clouds(random))


def _checks(random: np.random.Generator) -> Floats:
    x, y = _tile_coordinates()
    n = 2 * int(random.integers(1, 4))
    return ((np.floor(x * n) + np.floor(y * n)) % 2) * 0.8 + 0.2 * _noise(random, 64, 64)


def _stripes(random: np.random.Generator) -> Floats:
    return np.repeat(random.random(16), TILE_PX // 16) * 0.85 + 0.15 * _noise(random, 64, 64)


def _weave(random: np.random.Generator) -> Floats:
    x, y = _tile_coordinates()
    n = 2 * np.pi * int(random.integers(10, 24))
    woven: Floats = 0.25 + 0.25 * np.sin(x * n) * np.sin(y * n) + 0.5 * _clouds(random)
    return woven


def _carpet(random: np.random.Generator) -> Floats:
    x, y = _tile_coordinates()
    waves = np.sin(2 * np.pi * 3 * np.abs(x - 0.5)) * np.sin(2 * np.pi * 4 * np.abs(y - 0.5))
    edge = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y))
    knots = np.where(edge < 0.08, 0.1, 0.5 + 0.4 * np.sign(waves))
    return 0.8 * knots + 0.2 * _noise(random, 64, 64)


def _print(random: np.random.Generator) -> Floats:
    """A picture, poster or screen: soft fields under sharp ones."""
    tile = _noise(random, int(random.integers(1, 4)), int(random.integers(1, 5)))
    for _ in range(random.integers(2, 9)):
        a, b = np.sort(random.integers(0, TILE_PX, (2, 2)), axis=0)
        shade = float(random.random())
        if random.random() < 0.5:
            cv2.rectangle(tile, a.tolist(), b.tolist(), shade, -1)
        else:
            cv2.circle(tile, a.tolist(), int(random.integers(4, 30)), shade, -1)
    return tile


def _lines(random: np.random.Generator) -> Floats:
    """Printed paper, or windows full of text on a screen."""
    tile = np.ones((TILE_PX, TILE_PX), np.float32)
    for y in range(8, TILE_PX - 8, 6):
        tile[y : y + 3, 10 : int(random.integers(40, TILE_PX - 10))] = random.uniform(0.1, 0.5)
    return tile


def _terrazzo(random: np.random.Generator) -> Floats:
    """Terrazzo, granite, linoleum."""
    return (_noise(random, 40, 40) > 0.62) * 0.6 + 0.4 * _clouds(random)


PATTERNS: dict[str, Callable[[np.random.Generator], Floats]] = {
    "plaster": _plaster,
    "wood": _wood,
    "planks": _planks,
    "tiles": _tiles,
    "checks": _checks,
    "stripes": _stripes,
    "weave": _weave,
    "carpet": _carpet,
    "print": _print,
    "print2": _print,
    "lines": _lines,
    "terrazzo": _terrazzo,
}
"""Name -> function that draws it, (128, 128)."""


def draw_all(random: np.random.Generator) -> Floats:
    """One of each pattern, in the order of the table: (number, 128, 128) float32."""
    drawn = np.stack([draw(random) for draw in PATTERNS.values()])
    return np.clip(drawn, 0, 1).astype(np.float32)


def sample_pattern(tiles: Floats, pattern: npt.NDArray[np.int64], x: Floats, y: Floats) -> Floats:
    """Bilinear samples of patterns at coordinates (N), in repetitions."""
    flat = tiles.ravel()
    left, top = np.floor(x * TILE_PX).astype(np.int64), np.floor(y * TILE_PX).astype(np.int64)
    part_x = (x * TILE_PX - left).astype(np.float32)
    part_y = (y * TILE_PX - top).astype(np.float32)
    columns = left % TILE_PX, (left + 1) % TILE_PX
    value = np.zeros(x.shape, np.float32)
    for row, share in ((top, 1 - part_y), (top + 1, part_y)):
        start = (pattern * TILE_PX + row % TILE_PX) * TILE_PX
        a, b = (flat.take(start + column) for column in columns)
        value += share * (a + (b - a) * part_x)
    return value
