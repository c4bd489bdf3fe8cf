"""Furniture made of a few solids.

A piece of furniture, and parts that several of them share.

Each piece stands on y = 0, is centred on x = 0, has its back at z = 0 and faces along z.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from depthcli.datasets.rooms.materials import Material, Materials
from depthcli.datasets.rooms.solids import (
    CYLINDER_X,
    CYLINDER_Y,
    CYLINDER_Z,
    SPHERE,
    Part,
    box,
    centred_box,
)

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


class Piece(NamedTuple):
    """A piece of furniture."""

    parts: list[Part]
    width: float  #: along the wall, metres
    depth: float  #: from the wall, metres
    height: float  #: metres
    top: float = 0.0  #: height of a surface with objects on it, metres; 0 for none


def left_and_right(
    x: float, half: float, y: tuple[float, float], z: tuple[float, float], material: Material
) -> list[Part]:
    """Repeat a box at the left and at the right."""
    return [centred_box(half, y, z, material).moved((side, 0, 0)) for side in (-x, x)]


def counter(random: np.random.Generator, materials: Materials) -> Piece:
    """A kitchen counter: doors, worktop, sink and tap, sometimes cupboards above."""
    doors, depth, top = int(random.integers(2, 6)), 0.6, 0.9
    half, stone = doors * 0.3, materials.any()
    front = materials.pick([materials.white, materials.any(), *materials.woods])
    x = (random.integers(doors) + 0.5) * 0.6 - half
    slab, hanging = (top - 0.2, top), random.random() < 0.6
    parts = [
        centred_box(half, (0, 0.1), (0, depth - 0.06), materials.black),
        centred_box(half, (0.1, top - 0.2), (0, depth - 0.02), front),
        box((-half, x - 0.24), slab, (0, depth), stone),
        box((x + 0.24, half), slab, (0, depth), stone),
        box((x - 0.24, x + 0.24), slab, (0, 0.12), stone),
        box((x - 0.24, x + 0.24), slab, (0.52, depth), stone),
        *_tap(x, top, materials.metal),
    ]
    for i in range(doors):
        place, handle = (0.6 * (i + 0.5) - half, 0.0, 0.0), (0, top - 0.1, depth + 0.015)
        door = centred_box(0.294, (0.11, top - 0.05), (depth - 0.02, depth + 0.002), front)
        unit = [door, Part(handle, (0.08, 0.008, 0.01), materials.metal, CYLINDER_X)]
        unit += [centred_box(0.296, (1.45, 2.1), (0, 0.35), front)] if hanging else []
        parts += [part.moved(place) for part in unit]
    parts += small_objects(random, materials, (2 * half, 0.4), top)
    return Piece(parts, 2 * half, depth, 2.1, top)


def fridge(random: np.random.Generator, materials: Materials) -> Piece:
    """A fridge, or a washing machine if it is low."""
    height = random.choice([0.85, 1.4, 1.8])
    material = materials.pick([materials.white, materials.metal])
    parts, split = [centred_box(0.3, (0.03, height), (0, 0.6), material)], height * 0.65
    if height < 1:
        parts.append(Part((0, 0.45, 0.6), (0.17, 0.17, 0.02), materials.black, CYLINDER_Z))
        return Piece(parts, 0.6, 0.62, height)
    for low, high, y in ((0.05, split - 0.01, split - 0.3), (split, height, split + 0.05)):
        parts.append(centred_box(0.3, (low, high), (0.605, 0.65), material))
        parts.append(box((0.24, 0.26), (y, y + 0.25), (0.65, 0.69), materials.metal))
    return Piece(parts, 0.6, 0.68, height)


def basin(random: np.random.Generator, materials: Materials) -> Piece:
    """A washbasin of four sides around its bowl, a tap, a mirror above."""
    half, rim, white = random.uniform(0.25, 0.5), (0.69, 0.85), materials.white
    parts = [
        centred_box(half, (0.69, 0.73), (0, 0.46), white),
        *left_and_right(half - 0.025, 0.025, rim, (0, 0.46), white),
        *[centred_box(half, rim, (z, z + 0.06), white) for z in (0, 0.4)],
        Part((0, 0.345, 0.15), (0.08, 0.345, 0.08), white, CYLINDER_Y),
        centred_box(half, (1.05, random.uniform(1.6, 2.0)), (0, 0.02), materials.mirror),
        *_tap(0.0, 0.85, materials.metal),
    ]
    return Piece(parts, 2 * half, 0.48, 2.0)


def toilet(random: np.random.Generator, materials: Materials) -> Piece:
    """Cistern, bowl, lid up or down."""
    parts = [
        centred_box(0.19, (0.4, 0.8), (0, 0.17), materials.white),
        Part((0, 0.2, 0.42), (0.16, 0.2, 0.24), materials.white, (1, 0.2, 1)),
        Part((0, 0.41, 0.42), (0.19, 0.02, 0.25), materials.white, CYLINDER_Y),
        Part((0, 0.66, 0.2), (0.19, 0.24, 0.012), materials.white, CYLINDER_Z),
    ]
    return Piece(parts[: random.integers(3, 5)], 0.4, 0.68, 0.8)


def bathtub(random: np.random.Generator, materials: Materials) -> Piece:
    """Four sides and a bottom."""
    half, depth, rim, white = random.uniform(0.75, 0.9), 0.75, (0, 0.56), materials.white
    parts = [
        *left_and_right(half - 0.04, 0.04, rim, (0, depth), white),
        *[centred_box(half, rim, (z, z + 0.07), white) for z in (0, depth - 0.07)],
        centred_box(half, (0, 0.15), (0, depth), white),
        *_tap(half - 0.3, rim[1], materials.metal),
    ]
    return Piece(parts, 2 * half, depth, rim[1])


def _tap(x: float, top: float, material: Material) -> list[Part]:
    return [
        Part((x, top + 0.12, 0.06), (0.014, 0.12, 0.014), material, CYLINDER_Y),
        Part((x, top + 0.23, 0.14), (0.012, 0.012, 0.09), material, CYLINDER_Z),
    ]


_SOFT = (0.4, 0.4, 0.4)  # a cushion: a box with its corners off


def table(random: np.random.Generator, materials: Materials) -> Piece:
    """A dining or coffee table, with things on it."""
    top, width, depth = random.choice([0.42, 0.73, 0.76]), random.uniform(0.7, 1.8), 0.8
    wood = materials.pick([*materials.woods, materials.white])
    parts = _legs(width, depth, top, materials.pick([wood, materials.metal, materials.black]), 0.03)
    parts.append(centred_box(width / 2, (top - 0.035, top), (0, depth), wood))
    parts += small_objects(random, materials, (width, depth), top)
    return Piece(parts, width, depth, top, top)


def round_table(random: np.random.Generator, materials: Materials) -> Piece:
    """One foot, a round top."""
    top, radius = random.choice([0.5, 0.74, 1.05]), random.uniform(0.3, 0.65)
    parts = [
        Part(
            (0, top - 0.02, radius),
            (radius, 0.02, radius),
            materials.pick(materials.woods),
            CYLINDER_Y,
        ),
        Part((0, top / 2, radius), (0.04, top / 2, 0.04), materials.metal, CYLINDER_Y),
        Part((0, 0.015, radius), (radius / 2, 0.015, radius / 2), materials.metal, CYLINDER_Y),
    ]
    parts += small_objects(random, materials, (radius, 2 * radius), top)
    return Piece(parts, 2 * radius, 2 * radius, top, top)


def desk(random: np.random.Generator, materials: Materials) -> Piece:
    """Drawers at one side, a screen, a keyboard, clutter."""
    width, depth, top = random.uniform(1.0, 1.7), random.uniform(0.6, 0.8), 0.74
    wood = materials.pick([*materials.woods, materials.white])
    parts = [centred_box(width / 2, (top - 0.03, top), (0, depth), wood)]
    parts += _legs(width, depth, top, materials.metal, 0.025)
    drawers = [centred_box(0.21, (0.1, top - 0.03), (0.02, depth - 0.03), wood)]
    drawers += [
        centred_box(0.19, (y, y + 0.18), (0.1, depth - 0.015), wood) for y in (0.12, 0.32, 0.51)
    ]
    aside = random.choice([-1, 1]) * (width / 2 - 0.21)
    parts += [part.moved((aside, 0, 0)) for part in drawers]
    parts += computer(random, materials, random.uniform(-0.2, 0.2), top, depth)
    parts += small_objects(random, materials, (width, depth), top)
    return Piece(parts, width, depth, top, top)


def chair(random: np.random.Generator, materials: Materials) -> Piece:
    """Four legs, a seat, a back of a board or of slats."""
    seat, width, top = random.uniform(0.43, 0.48), random.uniform(0.4, 0.48), 0.9
    frame = materials.pick([*materials.woods, materials.metal])
    cover = materials.pick(materials.woods + materials.fabrics)
    half, depth = width / 2, 0.45
    parts = _legs(width, depth, seat, frame, 0.018)
    parts.append(centred_box(half, (seat, seat + 0.05), (0, depth), cover))
    parts += left_and_right(half - 0.018, 0.018, (seat, top), (0, 0.036), frame)
    if random.random() < 0.5:
        parts.append(centred_box(half, (seat + 0.15, top), (0, 0.04), cover).tilted(-6, 0))
    else:
        slats = (seat + 0.2, top - 0.07)
        parts += [centred_box(half, (y, y + 0.06), (0.005, 0.03), frame) for y in slats]
    return Piece(parts, width, depth, top)


def office_chair(random: np.random.Generator, materials: Materials) -> Piece:
    """A star of five, a post, cushions, arms."""
    cover, seat = materials.pick([materials.black, *materials.fabrics]), random.uniform(0.42, 0.52)
    foot = Part((0, 0.06, 0.16), (0.025, 0.025, 0.15), materials.black)
    parts = [foot.moved((0, 0, 0.28), 72 * i) for i in range(5)]
    parts += [
        Part((0, seat / 2, 0.28), (0.03, seat / 2, 0.03), materials.metal, CYLINDER_Y),
        Part((0, seat, 0.28), (0.25, 0.045, 0.24), cover, _SOFT),
        Part((0, seat + 0.35, 0.05), (0.22, 0.28, 0.05), cover, _SOFT).tilted(-8, 0),
    ]
    parts += left_and_right(0.27, 0.03, (seat + 0.18, seat + 0.21), (0.12, 0.4), materials.black)
    return Piece(parts, 0.6, 0.58, seat + 0.6)


def sofa(random: np.random.Generator, materials: Materials) -> Piece:
    """An armchair or a sofa of up to three seats, with cushions."""
    seats, step, arm = int(random.integers(1, 4)), random.uniform(0.55, 0.7), 0.16
    depth, seat, back = random.uniform(0.8, 0.95), random.uniform(0.38, 0.46), 0.8
    cover, half = materials.pick(materials.fabrics), seats * step / 2 + arm
    parts = [
        centred_box(half, (0.05, seat - 0.12), (0, depth), cover),
        centred_box(half, (0.05, back), (0, 0.2), cover).tilted(-4, 0),
        *left_and_right(half - arm / 2, arm / 2, (0.05, seat + 0.2), (0, depth), cover),
    ]
    for i in range(seats):
        x, size = arm - half + (i + 0.5) * step, (step / 2 - 0.008, 0.08, depth / 2 - 0.1)
        parts.append(Part((x, seat - 0.06, depth / 2 + 0.1), size, cover, (0.12, 0.12, 0.12)))
        if random.random() < 0.6:
            material = materials.pick(materials.fabrics)
            cushion = Part((x, seat + 0.2, 0.3), (0.21, 0.21, 0.09), material, _SOFT).tilted(-20, 0)
            parts.append(cushion.tilted(random.uniform(-20, 20), 2))
    return Piece(parts, 2 * half, depth, back)


def bed(random: np.random.Generator, materials: Materials) -> Piece:
    """Head at the wall, blanket, pillows."""
    width, length, top = random.choice([0.9, 1.4, 1.6]), 2.05, random.uniform(0.38, 0.55)
    wood, half = materials.pick(materials.woods), width / 2
    parts = [
        centred_box(half, (0.08, top - 0.2), (0, length), wood),
        centred_box(half, (0, random.uniform(0.7, 1.2)), (0, 0.05), wood),
        centred_box(half - 0.02, (top - 0.2, top), (0.05, length - 0.03), materials.white),
        centred_box(
            half, (top - 0.25, top + 0.03), (0.75, length), materials.pick(materials.fabrics)
        ),
    ]
    for x in (0.0,) if width < 1 else (-width / 4, width / 4):
        material = materials.pick([materials.white, *materials.fabrics])
        pillow = Part((x, top + 0.09, 0.32), (0.32, 0.1, 0.21), material, _SOFT)
        parts.append(pillow.tilted(random.uniform(-15, 5), 0))
    return Piece(parts, width, length, 1.0)


def shelf(random: np.random.Generator, materials: Materials) -> Piece:
    """Boards with books and other things."""
    half, depth = random.uniform(0.3, 0.8), random.uniform(0.25, 0.4)
    rows, step = int(random.integers(2, 7)), random.uniform(0.28, 0.38)
    wood, height = materials.pick([*materials.woods, materials.white]), rows * step + 0.05
    parts = [*left_and_right(half - 0.01, 0.01, (0, height), (0, depth), wood)]
    parts.append(centred_box(half, (0, height), (0, 0.01), wood))
    for row in range(rows + 1):
        y, size = row * step + 0.05, (2 * half - 0.06, depth)
        parts.append(centred_box(half, (y - 0.02, y), (0, depth), wood))
        parts += books(random, materials, size, y, step - 0.03) if row < rows else []
    return Piece(parts, 2 * half, depth, height)


def cupboard(random: np.random.Generator, materials: Materials) -> Piece:
    """A wardrobe, chest of drawers or sideboard."""
    width, depth = random.uniform(0.5, 2.0), random.uniform(0.38, 0.62)
    height = random.choice([0.55, 0.8, 0.95, 1.4, 1.95, 2.1])
    front = materials.pick([*materials.woods, materials.white, materials.any()])
    is_chest = height < 1.2
    parts = [centred_box(width / 2, (0.0, height), (0, depth - 0.02), front)]
    across = max(1, round(width / random.uniform(0.4, 0.9)))
    down = int(random.integers(2, 5)) if is_chest else 1
    w, h = width / across / 2, (height - 0.08) / down
    for i in range(across * down):
        x, y = -width / 2 + (2 * (i % across) + 1) * w, 0.07 + i // across * h
        door = centred_box(w - 0.006, (y, y + h - 0.012), (0.1, depth), front)
        knob = (0.0, y + h * 0.75) if is_chest else (w * 0.8, y + h / 2)
        size = (0.012, 0.012 if is_chest else 0.07, 0.012)
        handle = Part((*knob, depth + 0.012), size, materials.metal)
        parts += [part.moved((x, 0, 0)) for part in (door, handle)]
    parts += small_objects(random, materials, (width, depth), height) if is_chest else []
    return Piece(parts, width, depth, height, height if is_chest else 0.0)


def floor_lamp(random: np.random.Generator, materials: Materials) -> Piece:
    """Foot, post, shade that glows."""
    height, shade = random.uniform(1.3, 1.8), materials.lamp._replace(emission=1.2)
    parts = [
        Part((0, 0.015, 0.2), (0.14, 0.015, 0.14), materials.metal, CYLINDER_Y),
        Part((0, height / 2, 0.2), (0.012, height / 2, 0.012), materials.metal, CYLINDER_Y),
        Part((0, height, 0.2), (0.2, 0.14, 0.2), shade, CYLINDER_Y),
    ]
    return Piece(parts, 0.4, 0.4, height + 0.15)


def plant(random: np.random.Generator, materials: Materials) -> Piece:
    """A pot and leaves."""
    height, z = random.uniform(0.5, 1.5), 0.35
    shade = random.uniform(0.03, 0.15), random.uniform(0.12, 0.3), 0.04
    parts = [Part((0, 0.15, z), (0.15, 0.15, 0.15), materials.any(), CYLINDER_Y)]
    for _ in range(14):
        tilt, length = random.uniform(5, 60), height * random.uniform(0.25, 0.4)
        length *= 1 - 0.009 * tilt  # leaves that lean are shorter
        size, green = (0.05, length, 0.012), materials.of("plaster", shade, 0.6, 0.2)
        leaf = Part((0, 0, 0), size, green, SPHERE).tilted(tilt, 0)
        x, y, ahead = leaf.axes[1] * length * 0.9
        hanging = leaf._replace(centre=(x, y + 0.3, ahead))
        parts.append(hanging.moved((0, 0, z), random.uniform(0, 360)))
    return Piece(parts, 0.7, 0.7, height + 0.3)


def television(random: np.random.Generator, materials: Materials) -> Piece:
    """A screen on a low board."""
    half, size = random.uniform(0.65, 1.0), random.uniform(0.35, 0.62)
    screen = (
        materials.black if random.random() < 0.5 else materials.art(size * 2)._replace(emission=0.8)
    )
    parts = [
        centred_box(
            half, (0.05, 0.48), (0, 0.42), materials.pick([*materials.woods, materials.white])
        ),
        centred_box(0.15, (0.48, 0.5), (0.12, 0.32), materials.black),
        centred_box(size + 0.02, (0.53, 0.57 + size * 1.13), (0.19, 0.24), materials.black),
        centred_box(
            size, (0.55, 0.55 + size * 1.13), (0.24, 0.242), screen._replace(specular=0.06)
        ),
    ]
    return Piece(parts, 2 * half, 0.45, 1.1)


def bin_or_box(random: np.random.Generator, materials: Materials) -> Piece:
    """A bin, or one box or two."""
    half, height, material = random.uniform(0.12, 0.3), random.uniform(0.2, 0.6), materials.any()
    parts = [Part((0, height / 2, half), (half, height / 2, half), material, CYLINDER_Y)]
    if random.random() < 0.5:
        upper = centred_box(half * 0.8, (height, height * 1.6), (0.05, half * 1.7), materials.any())
        parts = [parts[0]._replace(quadric=(0, 0, 0)), upper.tilted(random.uniform(-8, 8), 1)]
    return Piece(parts, 2 * half, 2 * half, height * 1.6)


def _legs(
    width: float, depth: float, height: float, material: Material, radius: float
) -> list[Part]:
    x, low, high = width / 2 - radius - 0.01, radius + 0.01, depth - radius - 0.01
    size = (radius, height / 2, radius)
    return [Part((a, height / 2, b), size, material) for a in (-x, x) for b in (low, high)]


_MAKERS = (
    *(table, round_table, desk, chair, office_chair, sofa, bed, shelf, cupboard, counter, fridge),
    *(basin, toilet, bathtub, floor_lamp, plant, television, bin_or_box),
)
PIECES: dict[str, Callable[[np.random.Generator, Materials], Piece]] = {
    make.__name__: make for make in _MAKERS
}
"""The functions that make furniture, by name."""
