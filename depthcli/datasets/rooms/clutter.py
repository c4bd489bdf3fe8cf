"""Small things on tables, desks and shelves."""

import numpy as np

from depthcli.datasets.rooms.looks import Looks
from depthcli.datasets.rooms.solids import BALL, UPRIGHT, Part, box

_MOST = 9
_BOOK_WIDTHS = (0.015, 0.055)


def scattered(
    random: np.random.Generator, looks: Looks, size: tuple[float, float], top: float
) -> list[Part]:
    """Cups, bottles, books, papers, boxes, bowls, lamps on a surface (width, depth) at a height."""
    parts: list[Part] = []
    for _ in range(random.integers(0, _MOST)):
        x = random.uniform(-size[0] / 2 + 0.12, size[0] / 2 - 0.12)
        z = random.uniform(0.12, max(0.13, size[1] - 0.12))
        thing = _THINGS[random.integers(len(_THINGS))](random, looks)
        parts += [part.moved((x, top, z), random.uniform(0, 360)) for part in thing]
    return parts


def row_of_books(
    random: np.random.Generator, looks: Looks, size: tuple[float, float], y: float, height: float
) -> list[Part]:
    """A board (width, depth) partly full of books, a box or a vase at its end."""
    width, depth = size
    parts, x, end = [], -width / 2, width / 2 * random.uniform(-0.6, 1.0)
    while x < end:
        thick = random.uniform(*_BOOK_WIDTHS) * (3 if random.random() < 0.1 else 1)
        tall = height * random.uniform(0.6, 0.95)
        look = looks.any() if random.random() < 0.7 else looks.art()._replace(tile_m=tall)
        front = depth - random.uniform(0.01, 0.08)
        parts.append(
            box((x, min(x + thick - 0.001, width / 2)), (y, y + tall), (0.01, front), look)
        )
        x += thick + (random.random() < 0.08) * 0.06
    if width / 2 - x > 0.2:
        thing = _THINGS[random.integers(len(_THINGS))](random, looks)
        parts += [
            part.moved(((x + width / 2) / 2, y, depth / 2))
            for part in thing
            if part.half[1] < height / 2
        ]
    return parts


def computer(
    random: np.random.Generator, looks: Looks, x: float, top: float, depth: float
) -> list[Part]:
    """A screen on its foot or a laptop, a keyboard and a mouse."""
    picture = looks.black if random.random() < 0.3 else looks.art()._replace(glow=1.0, tile_m=0.5)
    yaw, half = random.uniform(-25, 25), random.uniform(0.16, 0.3)
    if random.random() < 0.3:
        lid = box((-0.17, 0.17), (0.01, 0.23), (-0.005, 0.0), looks.black).tilted(-15, 0)
        view = box((-0.16, 0.16), (0.02, 0.22), (0.002, 0.004), picture).tilted(-15, 0)
        base = box((-0.17, 0.17), (0, 0.018), (0.02, 0.25), looks.metal)
        return [part.moved((x, top, depth * 0.4), yaw) for part in (lid, view, base)]
    parts = [
        box((-0.1, 0.1), (0, 0.012), (-0.08, 0.08), looks.black),
        box((-0.02, 0.02), (0, 0.2), (-0.03, -0.01), looks.black),
        box((-half, half), (0.1, 0.12 + half * 1.2), (-0.01, 0.02), looks.black),
        box((0.012 - half, half - 0.012), (0.112, 0.108 + half * 1.2), (0.02, 0.022), picture),
    ]
    grey = looks.pick([looks.black, looks.white])
    keys = [
        box((-0.22, 0.22), (0, 0.02), (0.2, 0.34), grey),
        Part((0.3, 0.015, 0.28), (0.03, 0.018, 0.05), grey, BALL),
    ]
    return [part.moved((x, top, depth * 0.3), yaw) for part in parts] + [
        part.moved((x, top, depth * 0.3), yaw / 4) for part in keys
    ]


def _cup(random: np.random.Generator, looks: Looks) -> list[Part]:
    r, h = random.uniform(0.03, 0.05), random.uniform(0.04, 0.06)
    return [Part((0, h, 0), (r, h, r), looks.any(), UPRIGHT)]


def _bottle(random: np.random.Generator, looks: Looks) -> list[Part]:
    h, look = random.uniform(0.07, 0.12), looks.any()
    neck = Part((0, 2.5 * h, 0), (0.012, h / 2, 0.012), look, UPRIGHT)
    return [Part((0, h, 0), (0.035, h, 0.035), look, UPRIGHT), neck]


def _bowl(random: np.random.Generator, looks: Looks) -> list[Part]:
    r = random.uniform(0.08, 0.14)
    fruit = [
        Part((r / 2 * a, 0.07, r / 2 * b), (0.04, 0.04, 0.04), looks.any(), BALL)
        for a, b in ((1, 0), (-0.5, 0.8), (-0.5, -0.8))
    ]
    return [Part((0, 0.03, 0), (r, 0.03, r), looks.any(), UPRIGHT), *fruit[: random.integers(4)]]


def _books(random: np.random.Generator, looks: Looks) -> list[Part]:
    parts, y = [], 0.0
    for _ in range(random.integers(1, 5)):
        w, h, d = (
            random.uniform(0.06, 0.11),
            random.uniform(0.006, 0.025),
            random.uniform(0.09, 0.15),
        )
        look = looks.any() if random.random() < 0.5 else looks.art()._replace(tile_m=2 * d)
        parts.append(Part((0, y + h, 0), (w, h, d), look).tilted(random.uniform(-20, 20), 1))
        y += 2 * h
    return parts


def _paper(random: np.random.Generator, looks: Looks) -> list[Part]:
    return [
        Part((0.03 * i, 0.001 + 0.002 * i, 0), (0.105, 0.001, 0.15), looks.paper).tilted(
            random.uniform(-30, 30), 1
        )
        for i in range(random.integers(1, 4))
    ]


def _carton(random: np.random.Generator, looks: Looks) -> list[Part]:
    w, h, d = random.uniform(0.03, 0.12, 3)
    return [
        Part((0, h, 0), (w, h, d), looks.any() if w < 0.09 else looks.art()._replace(tile_m=2 * w))
    ]


def _lamp(random: np.random.Generator, looks: Looks) -> list[Part]:
    h = random.uniform(0.12, 0.2)
    return [
        Part((0, 0.01, 0), (0.07, 0.01, 0.07), looks.metal, UPRIGHT),
        Part((0, h, 0), (0.01, h, 0.01), looks.metal, UPRIGHT),
        Part((0, 2 * h + 0.05, 0), (0.11, 0.08, 0.11), looks.lamp._replace(glow=1.2), UPRIGHT),
    ]


_THINGS = (_cup, _cup, _bottle, _bowl, _books, _books, _paper, _paper, _carton, _carton, _lamp)
