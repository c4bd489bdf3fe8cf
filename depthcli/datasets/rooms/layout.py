"""The shell of a room: floor, ceiling, walls with windows and doors."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from depthcli.datasets.rooms.looks import Look, Looks
from depthcli.datasets.rooms.solids import Part, box

THICK_M = 0.2
_DOOR_M = (0.9, 2.05)


class Kind(NamedTuple):
    """What a sort of room is like.

    Attributes:
        sides: shortest and longest of its shorter and its longer side, metres.
        wishes: pieces of furniture, most important first.
        shape: ``L`` may have a corner cut out; ``open`` has pillars.
    """

    sides: tuple[tuple[float, float], tuple[float, float]]
    wishes: str
    shape: Literal["", "L", "open"] = ""


KINDS = {
    "living": Kind(
        ((2.8, 5.5), (3.5, 8)),
        "sofa television sofa table shelf round_table cupboard plant floor_lamp chair bin_or_box",
        "L",
    ),
    "bedroom": Kind(
        ((2.5, 4.5), (3, 5.5)),
        "bed cupboard desk shelf chair floor_lamp cupboard bin_or_box plant",
        "L",
    ),
    "kitchen": Kind(
        ((2, 4.5), (2.6, 6)),
        "counter fridge counter table round_table cupboard chair bin_or_box fridge",
    ),
    "bathroom": Kind(((2, 2.8), (2, 4)), "basin toilet bathtub fridge bin_or_box cupboard plant"),
    "office": Kind(
        ((2.8, 7), (3.5, 10)),
        "desk desk shelf desk cupboard desk shelf office_chair plant table bin_or_box bin_or_box",
        "L",
    ),
    "study": Kind(
        ((2.2, 4), (2.5, 5)),
        "desk shelf shelf sofa shelf office_chair bin_or_box bin_or_box floor_lamp",
        "L",
    ),
    "corridor": Kind(((1.3, 2.4), (4, 12)), "cupboard plant bin_or_box chair"),
    "hall": Kind(
        ((5, 9), (6, 12)),
        "table table round_table table sofa shelf television sofa cupboard plant plant bin_or_box",
        "open",
    ),
    "library": Kind(
        ((3, 7), (4, 11)),
        "shelf shelf shelf shelf table shelf shelf desk shelf shelf sofa chair",
        "L",
    ),
}
"""Sorts of rooms."""


class Opening(NamedTuple):
    """A hole in a wall: metres from the wall's middle, metres above the floor."""

    left: float
    right: float
    low: float
    high: float
    is_door: bool


@dataclass(frozen=True, slots=True)
class Wall:
    """One wall, seen from inside.

    Attributes:
        middle: where its middle stands: x, 0, z in metres.
        yaw_deg: direction into the room, from z towards x.
        length: metres.
        taken: (left, right, low, high) of what hangs on it, stands before it or opens it, metres.
    """

    middle: tuple[float, float, float]
    yaw_deg: float
    length: float
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def put(self, parts: list[Part]) -> list[Part]:
        """Parts in the wall's frame (x along it, z into the room), in the room's."""
        return [part.moved(self.middle, self.yaw_deg) for part in parts]

    def take(self, left: float, right: float, low: float, high: float) -> bool:
        """Reserve a rectangle of it, if that is inside and free."""
        inside = -self.length / 2 <= left and right <= self.length / 2
        free = all(right <= a or left >= b or high <= c or low >= d for a, b, c, d in self.taken)
        if inside and free:
            self.taken.append((left, right, low, high))
        return inside and free


@dataclass(frozen=True, slots=True)
class Shell:
    """An empty room, from (0, 0, 0) to (width, height, depth) metres.

    Attributes:
        groups: its solids.
        windows: of which wall, and where.
        corner: (x, z) from which on a corner is cut out; None for none.
    """

    kind: Kind
    width: float
    height: float
    depth: float
    walls: list[Wall]
    groups: list[list[Part]]
    windows: list[tuple[Wall, Opening]]
    corner: tuple[float, float] | None


def build_shell(random: np.random.Generator, looks: Looks, name: str) -> Shell:
    """A room of a sort, with windows and doors."""
    kind = KINDS[name]
    width, depth = (random.uniform(*side) for side in kind.sides)
    height = random.uniform(2.3, 2.9) if random.random() < 0.8 else random.uniform(2.9, 4.2)
    corner = None
    if kind.shape == "L" and random.random() < 0.35 and min(width, depth) > 2.6:
        corner = (width * random.uniform(0.5, 0.75), depth * random.uniform(0.5, 0.75))
    walls = _walls(width, depth, corner)
    ceiling = looks.white if random.random() < 0.9 else looks.pick(looks.woods)
    x, z = (-THICK_M, width + THICK_M), (-THICK_M, depth + THICK_M)
    groups = [
        [box(x, (-THICK_M, 0), z, looks.floor()), box(x, (height, height + THICK_M), z, ceiling)]
    ]
    if corner is not None:
        groups.append([box((corner[0], x[1]), (0, height), (corner[1], z[1]), looks.wall())])
    windows = []
    common, trim = looks.wall(), looks.pick([looks.white, *looks.woods])
    doorway = int(random.integers(4))
    for i, wall in enumerate(walls):
        look = common if random.random() < 0.8 else looks.wall()
        openings = []
        if i < 4:
            openings = _openings(random, wall, height, "door" if i == doorway else "window")
        pieces = _pieces(wall.length, height, openings, look)
        pieces.append(box((-wall.length / 2, wall.length / 2), (0, 0.08), (0, 0.012), trim))
        groups.append(wall.put(pieces))
        for opening in openings:
            parts = (
                _next_room(random, looks, opening, height)
                if opening.is_door
                else _window(random, looks, opening, trim)
            )
            groups.append(wall.put(parts))
            if not opening.is_door:
                windows.append((wall, opening))
        if not openings or random.random() < 0.3:
            groups.append(wall.put(_closed_door(random, looks, wall, trim)))
    if kind.shape == "open":
        groups.append(
            [
                box((px - 0.2, px + 0.2), (0, height), (pz - 0.2, pz + 0.2), common)
                for px in (width * 0.33, width * 0.67)
                for pz in (depth * 0.5,)
            ]
        )
    return Shell(kind, width, height, depth, walls, groups, windows, corner)


def _walls(width: float, depth: float, corner: tuple[float, float] | None) -> list[Wall]:
    x, z = corner or (width, depth)
    walls = [
        Wall((width / 2, 0, 0), 0, width),
        Wall((0, 0, depth / 2), 90, depth),
        Wall((x / 2, 0, depth), 180, x),
        Wall((width, 0, z / 2), 270, z),
    ]
    if corner is not None:
        walls += [
            Wall(((width + x) / 2, 0, z), 180, width - x),
            Wall((x, 0, (depth + z) / 2), 270, depth - z),
        ]
    return walls


def _openings(random: np.random.Generator, wall: Wall, height: float, what: str) -> list[Opening]:
    """A doorway or up to three windows, or nothing."""
    openings: list[Opening] = []
    if what == "door":
        if random.random() < 0.6:
            s = random.uniform(-0.4, 0.4) * (wall.length - _DOOR_M[0] - 0.2)
            openings.append(
                Opening(s - _DOOR_M[0] / 2, s + _DOOR_M[0] / 2, 0, _DOOR_M[1], is_door=True)
            )
    elif random.random() < 0.45:
        count = int(random.integers(1, 4))
        step = wall.length / count
        low = random.choice([0.1, 0.85, 0.95, 1.2])
        half, high = (
            min(random.uniform(0.35, 1.0), step / 2 - 0.15),
            random.uniform(2.0, height - 0.15),
        )
        for i in range(count if half > 0.25 else 0):
            s = (i + 0.5) * step - wall.length / 2
            openings.append(Opening(s - half, s + half, low, high, is_door=False))
    for opening in openings:
        wall.take(*opening[:4])
    return openings


def _pieces(length: float, height: float, openings: list[Opening], look: Look) -> list[Part]:
    """What is left of a wall around its openings."""
    thick, parts, at = (-THICK_M, 0.0), [], -length / 2 - THICK_M
    for opening in openings:
        parts.append(box((at, opening.left), (0, height), thick, look))
        parts.append(box((opening.left, opening.right), (opening.high, height), thick, look))
        if opening.low > 0:
            parts.append(box((opening.left, opening.right), (0, opening.low), thick, look))
        at = opening.right
    parts.append(box((at, length / 2 + THICK_M), (0, height), thick, look))
    return parts


def _window(random: np.random.Generator, looks: Looks, hole: Opening, trim: Look) -> list[Part]:
    """Frame, bars, sill; curtains or a blind."""
    left, right, low, high, _ = hole
    middle, z = (left + right) / 2, (-0.12, -0.07)
    parts = [
        box((a, a + 0.05), (low, high), z, trim) for a in (left, middle - 0.025, right - 0.05)
    ] + [box((left, right), (b, b + 0.05), z, trim) for b in (low, high - 0.05)]
    parts.append(box((left - 0.05, right + 0.05), (low - 0.03, low), (-0.1, 0.12), trim))
    dress = random.random()
    if dress < 0.35:
        cloth, top = looks.pick(looks.fabrics), high + 0.1
        bottom = 0.02 if random.random() < 0.6 else low - 0.1
        for side, edge in ((-1, left), (1, right)):
            for k in range(4):
                x = edge + side * (0.03 - 0.07 * k + 0.1)
                parts.append(
                    box((x - 0.04, x + 0.04), (bottom, top), (0.13, 0.15 + 0.02 * (k % 2)), cloth)
                )
    elif dress < 0.5:
        ends, look = random.uniform(low, high), looks.pick([looks.white, *looks.fabrics])
        count = int((high - ends) / 0.05)
        parts += [
            box((left, right), (high - 0.05 * k - 0.04, high - 0.05 * k), (-0.05, -0.04), look)
            for k in range(count)
        ]
    if low > 0.6 and random.random() < 0.5:
        parts += [
            box(
                (middle - 0.5 + 0.1 * k, middle - 0.42 + 0.1 * k),
                (0.15, 0.7),
                (0.04, 0.12),
                looks.white,
            )
            for k in range(10)
        ]
    return parts


def _next_room(
    random: np.random.Generator, looks: Looks, hole: Opening, height: float
) -> list[Part]:
    """What is seen through a doorway, and the door, open."""
    left, right, _, high, _ = hole
    a, b = left - random.uniform(0.1, 1.5), right + random.uniform(0.1, 1.5)
    z, wall, trim = -random.uniform(1.0, 4.5), looks.wall(), looks.pick([looks.white, *looks.woods])
    parts = [
        box((a, b), (-0.1, 0), (z, -THICK_M), looks.floor()),
        box((a, b), (height, height + 0.1), (z, -THICK_M), looks.white),
        box((a - 0.1, a), (0, height), (z, -THICK_M), wall),
        box((b, b + 0.1), (0, height), (z, -THICK_M), wall),
        box((a, b), (0, height), (z - 0.1, z), wall),
        *_door_frame(left, right, high, trim),
    ]
    if random.random() < 0.6:
        leaf = box((0, right - left), (0.01, high), (-0.02, 0.02), trim).moved(
            (0, 0, 0), random.uniform(60, 120)
        )
        parts.append(leaf.moved((left, 0, -THICK_M - 0.02)))
    return parts


def _closed_door(random: np.random.Generator, looks: Looks, wall: Wall, trim: Look) -> list[Part]:
    width, high = _DOOR_M
    s = random.uniform(-0.5, 0.5) * (wall.length - width)
    left, right = s - width / 2, s + width / 2
    if not wall.take(left - 0.1, right + 0.1, 0, high):
        return []
    look = looks.pick([trim, looks.white, *looks.woods])
    parts = [
        box((left, right), (0.01, high), (0, 0.02), look),
        *_door_frame(left, right, high, trim),
    ]
    if random.random() < 0.6:
        parts += [
            box((left + 0.15, right - 0.15), (y, y + 0.7), (0.02, 0.03), look) for y in (0.2, 1.1)
        ]
    handle = box((right - 0.2, right - 0.06), (1.03, 1.06), (0.06, 0.08), looks.metal)
    return [
        *parts,
        handle,
        box((right - 0.09, right - 0.06), (1.03, 1.06), (0.02, 0.08), looks.metal),
    ]


def _door_frame(left: float, right: float, high: float, look: Look) -> list[Part]:
    z = (-0.01, 0.03)
    posts = [box((a, a + 0.07), (0, high + 0.07), z, look) for a in (left - 0.07, right)]
    return [*posts, box((left - 0.07, right + 0.07), (high, high + 0.07), z, look)]
