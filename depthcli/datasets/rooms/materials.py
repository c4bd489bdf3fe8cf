"""Materials of surfaces: two colours, mixed by a repeating pattern."""

import colorsys
from typing import NamedTuple

import numpy as np

from depthcli.datasets.rooms.patterns import PATTERNS, draw_all

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
