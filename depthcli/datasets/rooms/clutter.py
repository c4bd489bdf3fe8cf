"""Small objects on tables, desks and shelves."""

import numpy as np

from depthcli.datasets.rooms.materials import Material, Materials
from depthcli.datasets.rooms.solids import CYLINDER_Y, SPHERE, Part, box, centred_box

_MAX_OBJECTS = 9


def small_objects(
    random: np.random.Generator, materials: Materials, size: tuple[float, float], top: float
) -> list[Part]:
    """Cups, bottles, books, papers, boxes, bowls, lamps on a surface (width, depth) at a height."""
    parts: list[Part] = []
    for _ in range(random.integers(0, _MAX_OBJECTS)):
        x = random.uniform(-0.5, 0.5) * max(size[0] - 0.24, 0)
        place = (x, top, random.uniform(0.12, max(0.13, size[1] - 0.12)))
        parts += [
            part.moved(place, random.uniform(0, 360)) for part in _small_object(random, materials)
        ]
    return parts


def books(
    random: np.random.Generator,
    materials: Materials,
    size: tuple[float, float],
    y: float,
    height: float,
) -> list[Part]:
    """A shelf board (width, depth) partly full of books, with another object at its end."""
    parts, x, right = [], -size[0] / 2, size[0] / 2
    end = right * random.uniform(-0.6, 1.0)
    while x < end:
        thick = random.uniform(0.015, 0.055) * (3 if random.random() < 0.1 else 1)
        tall, front = height * random.uniform(0.6, 0.95), size[1] - random.uniform(0.01, 0.08)
        span = (x, min(x + thick - 0.001, right))
        parts.append(box(span, (y, y + tall), (0.01, front), _cover(random, materials, tall)))
        x += thick + (random.random() < 0.08) * 0.06
    if right - x > 0.2:
        place = ((x + right) / 2, y, size[1] / 2)
        low = [part for part in _small_object(random, materials) if part.half[1] < height / 2]
        parts += [part.moved(place) for part in low]
    return parts


def computer(
    random: np.random.Generator, materials: Materials, x: float, top: float, depth: float
) -> list[Part]:
    """A screen on its foot or a laptop, a keyboard and a mouse."""
    half, black = random.uniform(0.16, 0.3), materials.black
    grey = materials.pick([materials.black, materials.white])
    image = black if random.random() < 0.3 else materials.art(2 * half)._replace(emission=1.0)
    image = image._replace(specular=0.06)
    if random.random() < 0.3:
        parts = [
            centred_box(0.17, (0.01, 0.23), (-0.005, 0.0), black).tilted(-15, 0),
            centred_box(0.16, (0.02, 0.22), (0.002, 0.004), image).tilted(-15, 0),
            centred_box(0.17, (0, 0.018), (0.02, 0.25), materials.metal),
        ]
    else:
        parts = [
            centred_box(0.1, (0, 0.012), (-0.08, 0.08), black),
            centred_box(0.02, (0, 0.2), (-0.03, -0.01), black),
            centred_box(half, (0.1, 0.12 + half * 1.2), (-0.01, 0.02), black),
            centred_box(half - 0.012, (0.112, 0.108 + half * 1.2), (0.02, 0.022), image),
            centred_box(0.22, (0, 0.02), (0.2, 0.34), grey),
            Part((0.3, 0.015, 0.28), (0.03, 0.018, 0.05), grey, SPHERE),
        ]
    yaw = random.uniform(-20, 20)
    return [part.moved((x, top, depth * 0.35), yaw) for part in parts]


def _cover(random: np.random.Generator, materials: Materials, size_m: float) -> Material:
    return materials.any() if random.random() < 0.65 else materials.art(size_m)


def _small_object(random: np.random.Generator, materials: Materials) -> list[Part]:
    """A small object, on y = 0 around x = z = 0."""
    a, b, c = random.uniform(0.03, 0.12, 3)
    material = materials.any()
    match random.integers(11):
        case 0 | 1:  # a cup
            return [Part((0, b / 2 + 0.02, 0), (0.04, b / 2 + 0.02, 0.04), material, CYLINDER_Y)]
        case 2:  # a bottle
            neck = Part((0, 0.24, 0), (0.012, 0.05, 0.012), material, CYLINDER_Y)
            return [Part((0, 0.1, 0), (0.035, 0.1, 0.035), material, CYLINDER_Y), neck]
        case 3:  # a bowl of fruit
            fruit = [
                Part((x, 0.07, 0.05), (0.04, 0.04, 0.04), materials.any(), SPHERE) for x in (-a, a)
            ]
            return [Part((0, 0.03, 0), (0.05 + a, 0.03, 0.05 + a), material, CYLINDER_Y), *fruit]
        case 4 | 5:  # books on each other
            size, covers = (a + 0.03, b / 6, c + 0.06), range(random.integers(1, 5))
            heap = [
                Part((0, b / 3 * i + b / 6, 0), size, _cover(random, materials, 0.2))
                for i in covers
            ]
            return [part.tilted(random.uniform(-20, 20), 1) for part in heap]
        case 6 | 7:  # papers
            heap = [
                Part((a * i, 0.001 + 0.002 * i, 0), (0.1, 0.001, 0.15), materials.paper)
                for i in (0, 1)
            ]
            return [part.tilted(random.uniform(-30, 30), 1) for part in heap]
        case 8 | 9:  # a box
            return [Part((0, b, 0), (a, b, c), _cover(random, materials, 2 * a))]
    shade = Part((0, 0.4, 0), (0.11, 0.08, 0.11), materials.lamp._replace(emission=1.2), CYLINDER_Y)
    foot, post = ((0, 0.01, 0), (0.07, 0.01, 0.07)), ((0, 0.17, 0), (0.01, 0.17, 0.01))
    return [shade, *(Part(*place, materials.metal, CYLINDER_Y) for place in (foot, post))]
