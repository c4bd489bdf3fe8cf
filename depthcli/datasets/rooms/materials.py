"""Materials of surfaces: two colours, mixed by a repeating pattern."""

import colorsys
from collections.abc import Callable
from typing import Any, NamedTuple

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


Colour = tuple[float, float, float]


class Material(NamedTuple):
    """The material of a solid."""

    pattern: int  #: index of its pattern
    dark: Colour  #: linear RGB in [0, 1] where the pattern is 0
    light: Colour  #: the same where it is 1
    tile_m: float = 1.0  #: size of one repetition, metres
    is_once: bool = False  #: whether the pattern is centred, for a tile as large as the solid
    emission: float = 0.0  #: light that it gives off itself, as a multiple of its colour
    specular: float = 0.0  #: share of a mirror's reflection, [0, 1]


_INDEX = {name: i for i, name in enumerate(PATTERNS)}


class Materials:
    """The materials of one room: its patterns, and materials that its furniture shares.

    Attributes:
        tiles: (number of patterns, 128, 128) float32 in [0, 1].
    """

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        self.tiles = draw_all(random)
        self.woods = [self.wood() for _ in range(2)]
        self.fabrics = [self.fabric() for _ in range(3)]
        self.white = self.paint(0.0, random.uniform(0.65, 0.9))
        self.black = self.paint(0.0, random.uniform(0.015, 0.05))
        self.metal = self.paint(0.05, random.uniform(0.3, 0.6))._replace(specular=0.15)
        self.mirror = self.paint(0.0, 0.8)._replace(specular=0.92)
        self.paper = Material(_INDEX["lines"], (0.1, 0.1, 0.1), (0.85, 0.85, 0.85), 0.3)
        self.lamp = self.paint(0.1, 0.9)._replace(emission=3.0)

    def pick(self, materials: list[Material]) -> Material:
        """One of several."""
        return materials[self._random.integers(len(materials))]

    def of(self, pattern: str, colour: Colour, contrast: float, tile_m: float) -> Material:
        """A material of one colour, with darker parts: contrast 0 is plain, 1 has black."""
        dark = (colour[0] * (1 - contrast), colour[1] * (1 - contrast), colour[2] * (1 - contrast))
        return Material(_INDEX[pattern], dark, colour, tile_m)

    def colour(self, saturation: float, value: float) -> Colour:
        """A colour of any hue."""
        return colorsys.hsv_to_rgb(self._random.random(), saturation, value)

    def paint(self, saturation: float, value: float) -> Material:
        """A nearly plain paint of a random hue."""
        return self.of("plaster", self.colour(saturation, value), 0.08, 0.9)

    def any(self) -> Material:
        """Paint, plastic, paper: any colour and brightness."""
        random = self._random
        return self.paint(random.random() ** 2, random.uniform(0.02, 0.85))

    def wood(self) -> Material:
        """From oak and birch to almost black."""
        random = self._random
        value = random.uniform(0.06, 0.6)
        colour = colorsys.hsv_to_rgb(random.uniform(0.05, 0.1), random.uniform(0.3, 0.7), value)
        return self.of("wood", colour, random.uniform(0.2, 0.6), random.uniform(0.5, 1.2))

    def fabric(self) -> Material:
        """Of sofas, curtains, beds."""
        random = self._random
        name = ("weave", "weave", "plaster", "stripes", "checks", "print")[random.integers(6)]
        colour = self.colour(random.random() ** 2 * 0.8, random.uniform(0.05, 0.8))
        return self.of(name, colour, random.uniform(0.1, 0.7), random.uniform(0.3, 0.9))

    def floor(self) -> Material:
        """Planks, tiles, carpet, stone."""
        random = self._random
        name = ("planks", "planks", "tiles", "weave", "plaster", "terrazzo", "checks")[
            random.integers(7)
        ]
        if name == "planks":
            return self.wood()._replace(pattern=_INDEX[name], tile_m=random.uniform(0.7, 1.4))
        colour = self.colour(random.random() ** 2 * 0.5, random.uniform(0.08, 0.6))
        return self.of(name, colour, random.uniform(0.15, 0.6), random.uniform(0.6, 1.6))

    def rug(self, size_m: float) -> Material:
        """A carpet with a border, which is shown once."""
        colour = self.colour(self._random.random(), self._random.uniform(0.1, 0.6))
        return self.of("carpet", colour, 0.6, size_m)._replace(is_once=True)

    def wall(self) -> Material:
        """Mostly light paint; sometimes stripes, bricks or wood."""
        random = self._random
        name = ("plaster", "plaster", "plaster", "plaster", "stripes", "tiles", "print")[
            random.integers(7)
        ]
        colour = self.colour(random.random() ** 2 * 0.35, random.uniform(0.25, 0.85))
        contrast = random.uniform(0.02, 0.1 if name == "plaster" else 0.4)
        return self.of(name, colour, contrast, random.uniform(0.5, 1.5))

    def art(self, size_m: float) -> Material:
        """A picture, poster, book cover or screen content of a width or height."""
        name = ("print", "print2", "lines")[self._random.integers(3)]
        dark = self.colour(self._random.random(), self._random.uniform(0.0, 0.4))
        light = self.colour(self._random.random() * 0.7, self._random.uniform(0.3, 0.9))
        return Material(_INDEX[name], dark, light, size_m, is_once=True)
