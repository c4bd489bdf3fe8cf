"""Light sources: ceiling lamps, and windows by day."""

from typing import NamedTuple

import numpy as np

from depthcli.datasets.rooms.layout import Shell, Wall
from depthcli.datasets.rooms.materials import Materials
from depthcli.datasets.rooms.openings import Opening
from depthcli.datasets.rooms.solids import CYLINDER_Y, Part, Vector, rotation


class Light(NamedTuple):
    """A lamp, or a window by day."""

    centre: Vector  #: metres
    across: tuple[Vector, Vector]  #: half of its extent in two directions, metres
    power: float  #: radiance times area
    tint: Vector  #: its colour, about 1
    facing: Vector = (0.0, 0.0, 0.0)  #: where it shines; zeros for all around


def ceiling_lamps(
    random: np.random.Generator, materials: Materials, shell: Shell
) -> tuple[list[Light], list[Part]]:
    """A row of lamps along the room's longer side."""
    count = max(1, round(max(shell.width, shell.depth) / random.uniform(3, 5)))
    warm, half = random.uniform(0.6, 1.0), random.uniform(0.1, 0.3)
    drop = random.uniform(0.05, 0.7) if shell.height > 2.4 and random.random() < 0.5 else 0.06
    y, tint = shell.height - drop, (1.1, 0.8 + 0.2 * warm, warm)
    lights, parts = [], []
    for i in range(count):
        share = (i + 0.5) / count
        x, z = (share, 0.5) if shell.width > shell.depth else (0.5, share)
        x, z = x * shell.width, z * shell.depth
        power = random.uniform(0.6, 1.4) * shell.width * shell.depth / count
        # Below its body, which would cast a shadow otherwise.
        lights.append(Light((x, y - 0.08, z), ((half, 0, 0), (0, 0, half)), power, tint))
        parts.append(Part((x, y, z), (half, 0.05, half), materials.lamp, CYLINDER_Y))
        parts.append(Part((x, y + drop / 2, z), (0.008, drop / 2, 0.008), materials.black))
    return lights, parts


def daylight(random: np.random.Generator, wall: Wall, hole: Opening) -> Light:
    """The light of a window."""
    turn, width, height = rotation(wall.yaw_deg, 1), hole.right - hole.left, hole.high - hole.low
    middle = np.array([(hole.left + hole.right) / 2, (hole.low + hole.high) / 2, -0.05])
    across = turn @ np.array([width / 2, 0, 0])
    return Light(
        tuple(turn @ middle + wall.middle),
        (tuple(across), (0, height / 2, 0)),
        random.uniform(2.0, 6.0) * width * height,
        (0.92, 0.97, 1.05),
        tuple(turn[:, 2]),
    )
