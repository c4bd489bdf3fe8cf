"""Windows and doors, in their wall's frame: x along it from its middle, z into the room."""

from typing import NamedTuple

import numpy as np

from depthcli.datasets.rooms.materials import Material, Materials
from depthcli.datasets.rooms.solids import Part, box, centred_box

WALL_THICKNESS_M = 0.2
DOOR_SIZE_M = (0.9, 2.05)


class Opening(NamedTuple):
    """A hole in a wall, metres from its middle and above the floor."""

    left: float
    right: float
    low: float
    high: float
    is_door: bool


def doorway(random: np.random.Generator, size: tuple[float, float]) -> list[Opening]:
    """One doorway, or none, in a wall of (length, height)."""
    s, half = random.uniform(-0.4, 0.4) * (size[0] - 1.1), DOOR_SIZE_M[0] / 2
    hole = Opening(s - half, s + half, 0, DOOR_SIZE_M[1], is_door=True)
    return [hole] if random.random() < 0.6 else []


def windows(random: np.random.Generator, size: tuple[float, float]) -> list[Opening]:
    """Up to three equal windows, in a wall of (length, height)."""
    count = int(random.integers(1, 4))
    step, low = size[0] / count, random.choice([0.1, 0.85, 0.95, 1.2])
    half = min(random.uniform(0.35, 1.0), step / 2 - 0.15)
    high = random.uniform(2.0, size[1] - 0.15)
    if half < 0.25 or random.random() < 0.55:
        return []
    middles = [(i + 0.5) * step - size[0] / 2 for i in range(count)]
    return [Opening(s - half, s + half, low, high, is_door=False) for s in middles]


def wall_parts(size: tuple[float, float], holes: list[Opening], material: Material) -> list[Part]:
    """The parts of a wall around its openings."""
    thick, parts, at = (-WALL_THICKNESS_M, 0.0), [], -size[0] / 2 - WALL_THICKNESS_M
    for hole in holes:
        across = (hole.left, hole.right)
        parts.append(box((at, hole.left), (0, size[1]), thick, material))
        parts.append(box(across, (hole.high, size[1]), thick, material))
        parts += [box(across, (0, hole.low), thick, material)] if hole.low else []
        at = hole.right
    return [*parts, box((at, size[0] / 2 + WALL_THICKNESS_M), (0, size[1]), thick, material)]


def skirting(length: float, holes: list[Opening], trim: Material) -> list[Part]:
    """A skirting board along a wall, interrupted by doorways."""
    doors = (side for hole in holes if hole.is_door for side in (hole.left, hole.right))
    ends = [-length / 2, *doors, length / 2]
    return [
        box(span, (0, 0.08), (0, 0.012), trim) for span in zip(ends[::2], ends[1::2], strict=True)
    ]


def window(
    random: np.random.Generator, materials: Materials, hole: Opening, height: float, trim: Material
) -> list[Part]:
    """Frame, bars, sill; curtains or a blind."""
    half, low, high, z = (hole.right - hole.left) / 2, hole.low, hole.high, (-0.12, -0.07)
    parts = [box((x, x + 0.05), (low, high), z, trim) for x in (-half, -0.025, half - 0.05)]
    parts += [centred_box(half, (y, y + 0.05), z, trim) for y in (low, high - 0.05)]
    parts.append(centred_box(half + 0.05, (low - 0.03, low), (-0.1, 0.12), trim))
    cloth, dress = materials.pick([materials.white, *materials.fabrics]), random.random()
    if dress < 0.35:
        folds = (0.02 if random.random() < 0.6 else low - 0.1, min(high + 0.1, height))
        for i, x in enumerate(np.arange(half - 0.15, half + 0.15, 0.07)):
            for side in (-x, x):
                fold = centred_box(0.04, folds, (0.13, 0.15 + 0.02 * (i % 2)), cloth)
                parts.append(fold.moved((side, 0, 0)))
    elif dress < 0.5:
        slats = np.arange(random.uniform(low, high), high, 0.05)
        parts += [centred_box(half, (y, y + 0.04), (-0.05, -0.04), cloth) for y in slats]
    return [part.moved(((hole.left + hole.right) / 2, 0, 0)) for part in parts]


def radiator(materials: Materials) -> list[Part]:
    """Ten ribs around x = 0."""
    ribs = np.arange(-0.5, 0.5, 0.1)
    return [box((x, x + 0.08), (0.15, 0.7), (0.04, 0.12), materials.white) for x in ribs]


def next_room(
    random: np.random.Generator, materials: Materials, hole: Opening, height: float, trim: Material
) -> list[Part]:
    """The part of the next room that is seen through a doorway, and the open door."""
    a, b = hole.left - random.uniform(0.1, 1.5), hole.right + random.uniform(0.1, 1.5)
    far, up, wall = -random.uniform(1.0, 4.5), (0.0, height), materials.wall()
    z = (far, -WALL_THICKNESS_M)
    parts = [
        box((a, b), (-0.1, 0), z, materials.floor()),
        box((a, b), (height, height + 0.1), z, materials.white),
        box((a - 0.1, a), up, z, wall),
        box((b, b + 0.1), up, z, wall),
        box((a, b), up, (far - 0.1, far), wall),
    ]
    if random.random() < 0.6:
        leaf = box((0, hole.right - hole.left), (0.01, hole.high), (-0.02, 0.02), trim)
        turned = leaf.moved((0, 0, 0), random.uniform(60, 120))
        parts.append(turned.moved((hole.left, 0, -WALL_THICKNESS_M - 0.02)))
    middle = ((hole.left + hole.right) / 2, 0, 0)
    return parts + [part.moved(middle) for part in _door_frame(trim)]


def closed_door(random: np.random.Generator, materials: Materials, trim: Material) -> list[Part]:
    """A leaf with or without panels, its handle and its frame, around x = 0."""
    material, (width, high) = materials.pick([trim, materials.white, *materials.woods]), DOOR_SIZE_M
    half, y = width / 2, (1.03, 1.06)
    parts = [centred_box(half, (0.01, high), (0, 0.02), material), *_door_frame(trim)]
    if random.random() < 0.6:
        parts += [
            centred_box(half - 0.15, (low, low + 0.7), (0.02, 0.03), material) for low in (0.2, 1.1)
        ]
    parts.append(box((half - 0.2, half - 0.06), y, (0.06, 0.08), materials.metal))
    return [*parts, box((half - 0.09, half - 0.06), y, (0.02, 0.08), materials.metal)]


def _door_frame(material: Material) -> list[Part]:
    half, high, z = DOOR_SIZE_M[0] / 2, DOOR_SIZE_M[1], (-0.01, 0.03)
    posts = [box((x, x + 0.07), (0, high + 0.07), z, material) for x in (-half - 0.07, half)]
    return [*posts, centred_box(half + 0.07, (high, high + 0.07), z, material)]
