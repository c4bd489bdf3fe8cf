"""Furniture made of a few solids.

Each piece stands on y = 0, is centred on x = 0, has its back at z = 0 and looks along z.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from depthcli.datasets.rooms import clutter
from depthcli.datasets.rooms.looks import Look, Looks
from depthcli.datasets.rooms.solids import ALONG_X, BALL, UPRIGHT, Part, box


class Piece(NamedTuple):
    """A piece of furniture.

    Attributes:
        parts: its solids.
        width: along the wall, metres.
        depth: from the wall, metres.
        height: metres.
        top: height of a surface where things may stand, metres; 0 for none.
    """

    parts: list[Part]
    width: float
    depth: float
    height: float
    top: float = 0.0


def table(random: np.random.Generator, looks: Looks) -> Piece:
    """A dining table, desk or coffee table, with things on it."""
    height = random.choice([0.42, 0.73, 0.73, 0.76])
    width, depth = random.uniform(0.7, 1.8), random.uniform(0.55, 0.95)
    wood = looks.pick([*looks.woods, looks.white])
    parts = _legs(width, depth, height, looks.pick([wood, looks.metal, looks.black]), 0.03)
    parts.append(box((-width / 2, width / 2), (height - 0.035, height), (0, depth), wood))
    parts += clutter.scattered(random, looks, (width, depth), height)
    return Piece(parts, width, depth, height, height)


def round_table(random: np.random.Generator, looks: Looks) -> Piece:
    """One foot, a round top."""
    height, radius = random.choice([0.5, 0.74, 1.05]), random.uniform(0.3, 0.65)
    wood = looks.pick(looks.woods)
    parts = [
        Part((0, height - 0.02, radius), (radius, 0.02, radius), wood, UPRIGHT),
        Part((0, height / 2, radius), (0.04, height / 2, 0.04), looks.metal, UPRIGHT),
        Part((0, 0.015, radius), (radius / 2, 0.015, radius / 2), looks.metal, UPRIGHT),
    ]
    parts += clutter.scattered(random, looks, (radius, 2 * radius), height)
    return Piece(parts, 2 * radius, 2 * radius, height, height)


def desk(random: np.random.Generator, looks: Looks) -> Piece:
    """Drawers at one side, a screen, a keyboard, clutter."""
    width, depth, top = random.uniform(1.0, 1.7), random.uniform(0.6, 0.8), 0.74
    wood = looks.pick([*looks.woods, looks.white])
    half, side = width / 2, random.choice([-1, 1])
    parts = [
        box((-half, half), (top - 0.03, top), (0, depth), wood),
        *_legs(width, depth, top, looks.metal, 0.025),
        box(
            sorted((side * half, side * (half - 0.42))),
            (0.1, top - 0.03),
            (0.02, depth - 0.03),
            wood,
        ),
    ]
    x = side * (half - 0.21)
    parts += [
        box((x - 0.19, x + 0.19), (y, y + 0.18), (depth - 0.03, depth - 0.015), wood)
        for y in (0.12, 0.32, 0.51)
    ]
    parts += clutter.computer(random, looks, random.uniform(-0.2, 0.2), top, depth)
    parts += clutter.scattered(random, looks, (width, depth), top)
    return Piece(parts, width, depth, top, top)


def chair(random: np.random.Generator, looks: Looks) -> Piece:
    """Four legs, seat, a back of a board or of slats."""
    seat, width, depth = random.uniform(0.43, 0.48), random.uniform(0.4, 0.48), 0.45
    top = random.uniform(0.8, 1.0)
    frame, cover = (
        looks.pick([*looks.woods, looks.metal]),
        looks.pick([*looks.woods, *looks.fabrics]),
    )
    half = width / 2
    parts = _legs(width, depth, seat, frame, 0.018)
    parts.append(box((-half, half), (seat, seat + 0.05), (0, depth), cover))
    posts = [
        box((x - 0.018, x + 0.018), (seat, top), (0, 0.036), frame)
        for x in (0.018 - half, half - 0.018)
    ]
    if random.random() < 0.5:
        back = [box((-half, half), (seat + 0.15, top), (0, 0.04), cover).tilted(-6, 0)]
    else:
        back = [
            box((-half, half), (y, y + 0.06), (0.005, 0.03), frame)
            for y in (seat + 0.2, top - 0.07)
        ]
    return Piece([*parts, *posts, *back], width, depth, top)


def office_chair(random: np.random.Generator, looks: Looks) -> Piece:
    """A star of five, a post, cushions."""
    cover, seat = looks.pick([looks.black, *looks.fabrics]), random.uniform(0.42, 0.52)
    star = [
        Part((0, 0.06, 0.16), (0.025, 0.025, 0.15), looks.black).moved((0, 0, 0.28), 72 * i)
        for i in range(5)
    ]
    parts = [
        Part((0, seat / 2, 0.28), (0.03, seat / 2, 0.03), looks.metal, UPRIGHT),
        Part((0, seat, 0.28), (0.25, 0.045, 0.24), cover, (0.4, 0.4, 0.4)),
        Part((0, seat + 0.35, 0.05), (0.22, 0.28, 0.05), cover, (0.35, 0.35, 0.35)).tilted(-8, 0),
    ]
    arms = [
        box((x - 0.03, x + 0.03), (seat + 0.18, seat + 0.21), (0.12, 0.4), looks.black)
        for x in (-0.27, 0.27)
    ]
    return Piece([*star, *parts, *arms], 0.6, 0.58, seat + 0.6)


def sofa(random: np.random.Generator, looks: Looks) -> Piece:
    """An armchair or a sofa of up to three seats, with cushions."""
    seats = int(random.integers(1, 4))
    seat_width, depth, arm = (
        random.uniform(0.55, 0.7),
        random.uniform(0.8, 0.95),
        random.uniform(0.12, 0.22),
    )
    cover, width = looks.pick(looks.fabrics), seats * seat_width + 2 * arm
    seat, back = random.uniform(0.38, 0.46), random.uniform(0.7, 0.9)
    half = width / 2
    parts = [
        box((-half, half), (0.05, seat - 0.12), (0, depth), cover),
        box((-half, half), (0.05, back), (0, 0.2), cover).tilted(-4, 0),
        box((-half, arm - half), (0.05, seat + 0.2), (0, depth), cover),
        box((half - arm, half), (0.05, seat + 0.2), (0, depth), cover),
    ]
    for i in range(seats):
        x = arm - half + (i + 0.5) * seat_width
        parts.append(
            Part(
                (x, seat - 0.06, 0.5 * depth + 0.1),
                (seat_width / 2 - 0.008, 0.08, depth / 2 - 0.1),
                cover,
                (0.12,) * 3,
            )
        )
        if random.random() < 0.6:
            cushion = Part(
                (x, seat + 0.2, 0.3), (0.21, 0.21, 0.09), looks.pick(looks.fabrics), (0.4, 0.4, 0.4)
            )
            parts.append(cushion.tilted(-20, 0).tilted(random.uniform(-20, 20), 2))
    return Piece(parts, width, depth, back)


def bed(random: np.random.Generator, looks: Looks) -> Piece:
    """Head at the wall, blanket, pillows."""
    width, length, top = random.choice([0.9, 1.4, 1.6]), 2.05, random.uniform(0.38, 0.55)
    wood, half = looks.pick(looks.woods), width / 2
    parts = [
        box((-half, half), (0.08, top - 0.2), (0, length), wood),
        box((-half, half), (0, random.uniform(0.7, 1.2)), (0, 0.05), wood),
        box((0.02 - half, half - 0.02), (top - 0.2, top), (0.05, length - 0.03), looks.white),
        box((-half, half), (top - 0.25, top + 0.03), (0.75, length), looks.pick(looks.fabrics)),
    ]
    for x in (0.0,) if width < 1 else (-width / 4, width / 4):
        pillow = Part(
            (x, top + 0.09, 0.32),
            (0.32, 0.1, 0.21),
            looks.pick([looks.white, *looks.fabrics]),
            (0.45,) * 3,
        )
        parts.append(pillow.tilted(random.uniform(-15, 5), 0))
    return Piece(parts, width, length, 1.0)


def shelf(random: np.random.Generator, looks: Looks) -> Piece:
    """Boards with books and other things."""
    width, depth = random.uniform(0.6, 1.6), random.uniform(0.25, 0.4)
    rows, step = int(random.integers(2, 7)), random.uniform(0.28, 0.38)
    wood, half, height = looks.pick([*looks.woods, looks.white]), width / 2, rows * step + 0.05
    parts = [box((x, x + 0.02), (0, height), (0, depth), wood) for x in (-half, half - 0.02)]
    parts.append(box((-half, half), (0, height), (0, 0.01), wood))
    for row in range(rows + 1):
        y = row * step + 0.03
        parts.append(box((-half, half), (y, y + 0.02), (0, depth), wood))
        if row < rows:
            parts += clutter.row_of_books(
                random, looks, (width - 0.06, depth), y + 0.02, step - 0.03
            )
    return Piece(parts, width, depth, height, height)


def cupboard(random: np.random.Generator, looks: Looks) -> Piece:
    """A wardrobe, chest of drawers or sideboard."""
    width, depth = random.uniform(0.5, 2.0), random.uniform(0.38, 0.62)
    height = random.choice([0.55, 0.8, 0.95, 1.4, 1.95, 2.1])
    front, half = looks.pick([*looks.woods, looks.white, looks.any()]), width / 2
    parts = [box((-half, half), (0.0, height), (0, depth - 0.02), front)]
    across = max(1, round(width / random.uniform(0.4, 0.9)))
    down = int(random.integers(2, 5)) if height < 1.2 else 1
    w, h = width / across, (height - 0.08) / down
    for i in range(across):
        for j in range(down):
            x, y = -half + i * w, 0.07 + j * h
            parts.append(
                box((x + 0.006, x + w - 0.006), (y, y + h - 0.012), (depth - 0.02, depth), front)
            )
            hx, hy = (
                (x + w / 2, y + h * 0.75)
                if down > 1
                else (x + w * (0.12, 0.88)[i % 2 == 0], y + h / 2)
            )
            parts.append(
                Part(
                    (hx, hy, depth + 0.012),
                    (0.012, 0.012 if down > 1 else 0.07, 0.012),
                    looks.metal,
                )
            )
    if height < 1.5:
        parts += clutter.scattered(random, looks, (width, depth), height)
    return Piece(parts, width, depth, height, height if height < 1.5 else 0.0)


def counter(random: np.random.Generator, looks: Looks) -> Piece:
    """A kitchen's: doors, worktop, sink and tap, sometimes cupboards above."""
    doors, depth, top = int(random.integers(2, 6)), 0.6, 0.9
    width, half = doors * 0.6, doors * 0.3
    front, stone, base = (
        looks.pick([looks.white, looks.any(), *looks.woods]),
        looks.any(),
        looks.black,
    )
    sink = (random.integers(doors) + 0.5) * 0.6 - half
    edges = [-half, sink - 0.24, sink + 0.24, half]
    parts = [box((-half, half), (0, 0.1), (0, depth - 0.06), base)]
    parts.append(box((-half, half), (0.1, top - 0.2), (0, depth - 0.02), front))
    for a, b, depth_from, depth_to in (
        (edges[0], edges[1], 0.0, depth),
        (edges[2], edges[3], 0.0, depth),
        (edges[1], edges[2], 0.0, 0.12),
        (edges[1], edges[2], 0.52, depth),
    ):
        parts.append(box((a, b), (top - 0.2, top), (depth_from, depth_to), stone))
    parts += [
        box(
            (-half + 0.6 * i + 0.006, -half + 0.6 * i + 0.594),
            (0.11, top - 0.05),
            (depth - 0.02, depth + 0.002),
            front,
        )
        for i in range(doors)
    ]
    parts += [
        Part(
            (0.6 * (i + 0.5) - half, top - 0.1, depth + 0.015),
            (0.08, 0.008, 0.01),
            looks.metal,
            ALONG_X,
        )
        for i in range(doors)
    ]
    parts += _tap(sink, top, looks.metal)
    if random.random() < 0.6:
        parts += [
            box((-half + 0.6 * i + 0.004, -half + 0.6 * i + 0.596), (1.45, 2.1), (0, 0.35), front)
            for i in range(doors)
        ]
    parts += clutter.scattered(random, looks, (width, 0.4), top)
    return Piece(parts, width, depth, 2.1, top)


def fridge(random: np.random.Generator, looks: Looks) -> Piece:
    """Or a washing machine, where it is low."""
    height, look = (
        random.choice([0.85, 1.4, 1.8]),
        looks.pick([looks.white, looks.white, looks.metal]),
    )
    parts = [box((-0.3, 0.3), (0.03, height), (0, 0.6), look)]
    if height < 1:
        parts.append(Part((0, 0.45, 0.6), (0.17, 0.17, 0.02), looks.black, (1, 1, 0)))
    else:
        split = height * 0.65
        parts += [
            box((-0.3, 0.3), (a, b), (0.605, 0.65), look)
            for a, b in ((0.05, split - 0.01), (split, height))
        ]
        parts += [
            box((0.24, 0.26), (split + s, split + s + 0.25), (0.65, 0.69), looks.metal)
            for s in (-0.3, 0.05)
        ]
    return Piece(parts, 0.6, 0.68, height, height if height < 1 else 0.0)


def basin(random: np.random.Generator, looks: Looks) -> Piece:
    """A washbasin of two halves around its bowl, a tap, a mirror above."""
    top, half = 0.85, random.uniform(0.25, 0.5)
    parts = [
        box((-half, half), (top - 0.16, top - 0.12), (0, 0.46), looks.white),
        *[
            box((x, x + 0.05), (top - 0.16, top), (0, 0.46), looks.white)
            for x in (-half, half - 0.05)
        ],
        *[box((-half, half), (top - 0.16, top), (z, z + 0.06), looks.white) for z in (0, 0.40)],
        Part((0, top / 2 - 0.08, 0.15), (0.08, top / 2 - 0.08, 0.08), looks.white, UPRIGHT),
        box((-half, half), (1.05, random.uniform(1.6, 2.0)), (0, 0.02), looks.mirror),
        *_tap(0.0, top, looks.metal),
    ]
    return Piece(parts, 2 * half, 0.48, 2.0)


def toilet(random: np.random.Generator, looks: Looks) -> Piece:
    """Cistern, bowl, lid up or down."""
    white = looks.white
    parts = [
        box((-0.19, 0.19), (0.4, 0.8), (0, 0.17), white),
        Part((0, 0.2, 0.42), (0.16, 0.2, 0.24), white, (1, 0.2, 1)),
        Part((0, 0.41, 0.42), (0.19, 0.02, 0.25), white, UPRIGHT),
    ]
    if random.random() < 0.3:
        parts.append(Part((0, 0.66, 0.2), (0.19, 0.24, 0.012), white, (1, 1, 0)))
    return Piece(parts, 0.4, 0.68, 0.8)


def bathtub(random: np.random.Generator, looks: Looks) -> Piece:
    """Four sides and a bottom."""
    half, depth, top = random.uniform(0.75, 0.9), 0.75, 0.56
    sides = [
        ((-half, 0.08 - half), (0, depth)),
        ((half - 0.08, half), (0, depth)),
        ((-half, half), (0, 0.07)),
        ((-half, half), (depth - 0.07, depth)),
    ]
    parts = [box(x, (0, top), z, looks.white) for x, z in sides]
    parts += [
        box((-half, half), (0, 0.15), (0, depth), looks.white),
        *_tap(half - 0.3, top, looks.metal),
    ]
    return Piece(parts, 2 * half, depth, top)


def floor_lamp(random: np.random.Generator, looks: Looks) -> Piece:
    """Foot, post, shade that glows."""
    height = random.uniform(1.3, 1.8)
    parts = [
        Part((0, 0.015, 0.2), (0.14, 0.015, 0.14), looks.metal, UPRIGHT),
        Part((0, height / 2, 0.2), (0.012, height / 2, 0.012), looks.metal, UPRIGHT),
        Part((0, height, 0.2), (0.2, 0.14, 0.2), looks.lamp._replace(glow=1.2), UPRIGHT, _FRUSTUM),
    ]
    return Piece(parts, 0.4, 0.4, height + 0.15)


def plant(random: np.random.Generator, looks: Looks) -> Piece:
    """A pot and leaves."""
    height, z = random.uniform(0.5, 1.5), 0.35
    shade = random.uniform(0.03, 0.15), random.uniform(0.12, 0.3), 0.04
    green = looks.of("plaster", shade, 0.6, 0.2)
    parts = [Part((0, 0.15, z), (0.15, 0.15, 0.15), looks.any(), UPRIGHT)]
    for _ in range(14):
        tilt, length = random.uniform(5, 60), height * random.uniform(0.25, 0.4)
        length *= 1 - 0.006 * tilt  # what hangs over is shorter
        leaf = Part((0, 0, 0), (0.05, length, 0.012), green, BALL).tilted(tilt, 0)
        x, y, ahead = leaf.axes[1] * length * 0.9
        hanging = leaf._replace(centre=(x, y + 0.3, ahead))
        parts.append(hanging.moved((0, 0, z), random.uniform(0, 360)))
    return Piece(parts, 0.7, 0.7, height + 0.3)


def television(random: np.random.Generator, looks: Looks) -> Piece:
    """A screen on a low board."""
    width, size = random.uniform(1.1, 2.0), random.uniform(0.35, 0.62)
    look = looks.pick([*looks.woods, looks.white])
    screen = (
        looks.black if random.random() < 0.5 else looks.art()._replace(glow=0.8, tile_m=size * 2)
    )
    parts = [
        box((-width / 2, width / 2), (0.05, 0.48), (0, 0.42), look),
        box((-0.15, 0.15), (0.48, 0.5), (0.12, 0.32), looks.black),
        box((-size - 0.02, size + 0.02), (0.53, 0.57 + size * 1.13), (0.19, 0.24), looks.black),
        box((-size, size), (0.55, 0.55 + size * 1.13), (0.24, 0.242), screen._replace(gloss=0.06)),
    ]
    return Piece(parts, width, 0.45, 1.1)


def bin_or_box(random: np.random.Generator, looks: Looks) -> Piece:
    """A bin, a stool, cardboard boxes."""
    width, height = random.uniform(0.25, 0.6), random.uniform(0.2, 0.6)
    look, half = looks.any(), width / 2
    if random.random() < 0.5:
        return Piece(
            [Part((0, height / 2, half), (half, height / 2, half), look, UPRIGHT)],
            width,
            width,
            height,
        )
    parts = [box((-half, half), (0, height), (0, width), look)]
    if random.random() < 0.5:
        smaller = box(
            (-half * 0.8, half * 0.8), (height, height * 1.7), (0.05, width * 0.85), looks.any()
        )
        parts.append(smaller.moved((0, 0, 0), random.uniform(-8, 8)))
    return Piece(parts, width, width, height * 1.7)


_FRUSTUM = tuple((x, 0.35, z) for x, z in ((0.9, 0.0), (-0.9, 0.0), (0.0, 0.9), (0.0, -0.9)))


def _legs(width: float, depth: float, height: float, look: Look, radius: float) -> list[Part]:
    x, z = width / 2 - radius - 0.01, depth - radius - 0.01
    corners = [(a, b) for a in (-x, x) for b in (radius + 0.01, z)]
    return [Part((a, height / 2, b), (radius, height / 2, radius), look) for a, b in corners]


def _tap(x: float, top: float, look: Look) -> list[Part]:
    return [
        Part((x, top + 0.12, 0.06), (0.014, 0.12, 0.014), look, UPRIGHT),
        Part((x, top + 0.23, 0.14), (0.012, 0.012, 0.09), look, (1, 1, 0)),
    ]


PIECES: dict[str, Callable[[np.random.Generator, Looks], Piece]] = {
    "table": table,
    "round_table": round_table,
    "desk": desk,
    "chair": chair,
    "office_chair": office_chair,
    "sofa": sofa,
    "bed": bed,
    "shelf": shelf,
    "cupboard": cupboard,
    "counter": counter,
    "fridge": fridge,
    "basin": basin,
    "toilet": toilet,
    "bathtub": bathtub,
    "floor_lamp": floor_lamp,
    "plant": plant,
    "television": television,
    "bin_or_box": bin_or_box,
}
"""What a room may be furnished with."""
