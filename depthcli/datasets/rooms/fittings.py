"""Fittings of kitchens and bathrooms."""

import numpy as np

from depthcli.datasets.rooms import clutter
from depthcli.datasets.rooms.materials import Material, Materials
from depthcli.datasets.rooms.piece import Piece, left_and_right
from depthcli.datasets.rooms.solids import (
    CYLINDER_X,
    CYLINDER_Y,
    CYLINDER_Z,
    Part,
    box,
    centred_box,
)


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
    parts += clutter.small_objects(random, materials, (2 * half, 0.4), top)
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
