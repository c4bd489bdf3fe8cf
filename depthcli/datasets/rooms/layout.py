"""The shell of a room: floor, ceiling, walls with windows and doors."""

from dataclasses import dataclass, field

import numpy as np

from depthcli.datasets.rooms import openings
from depthcli.datasets.rooms.materials import Material, Materials
from depthcli.datasets.rooms.openings import DOOR_SIZE_M, WALL_THICKNESS_M, Opening
from depthcli.datasets.rooms.room_types import ROOM_TYPES, RoomType
from depthcli.datasets.rooms.solids import Part, Vector, box

_OUTER_WALLS = 4


@dataclass(frozen=True, slots=True)
class Wall:
    """One wall, seen from inside."""

    middle: Vector  #: its centre on the floor, metres
    yaw_deg: float  #: direction into the room, from z towards x
    length: float  #: metres
    #: (left, right, low, high) of objects on it, furniture before it and openings, metres
    occupied: list[tuple[float, float, float, float]] = field(default_factory=list)

    def to_room(self, parts: list[Part]) -> list[Part]:
        """Parts from the wall's frame (x along it, z into the room) to the room's."""
        return [part.moved(self.middle, self.yaw_deg) for part in parts]

    def reserve(self, left: float, right: float, low: float, high: float) -> bool:
        """Reserve a rectangle of the wall, if it is inside and free."""
        inside = -self.length / 2 <= left and right <= self.length / 2
        free = all(right <= a or left >= b or high <= c or low >= d for a, b, c, d in self.occupied)
        if inside and free:
            self.occupied.append((left, right, low, high))
        return inside and free


@dataclass(frozen=True, slots=True)
class Shell:
    """An empty room, from (0, 0, 0) to (width, height, depth) metres."""

    kind: RoomType
    width: float
    height: float
    depth: float
    corner: tuple[float, float] | None  #: (x, z) beyond which a corner is cut out
    walls: list[Wall]
    groups: list[list[Part]] = field(default_factory=list)  #: its solids
    #: (low x, high x, low z, high z) of its pillars, metres
    pillars: list[tuple[float, float, float, float]] = field(default_factory=list)
    windows: list[tuple[Wall, Opening]] = field(default_factory=list)  #: and the walls they are in


def build_shell(random: np.random.Generator, materials: Materials, name: str) -> Shell:
    """A room of a type, with windows and doors."""
    kind = ROOM_TYPES[name]
    width, depth = (random.uniform(*side) for side in kind.sides_m)
    height = random.uniform(2.3, 2.9) if random.random() < 0.8 else random.uniform(2.9, 4.2)
    corner = None
    if kind.shape == "L" and random.random() < 0.35 and min(width, depth) > 2.6:
        corner = (width * random.uniform(0.5, 0.75), depth * random.uniform(0.5, 0.75))
    shell = Shell(kind, width, height, depth, corner, _walls(width, depth, corner))
    x, z = (
        (-WALL_THICKNESS_M, width + WALL_THICKNESS_M),
        (-WALL_THICKNESS_M, depth + WALL_THICKNESS_M),
    )
    ceiling = materials.white if random.random() < 0.9 else materials.pick(materials.woods)
    slabs = (
        box(x, (-WALL_THICKNESS_M, 0), z, materials.floor()),
        box(x, (height, height + 0.2), z, ceiling),
    )
    shell.groups.append([*slabs])
    common, trim = materials.wall(), materials.pick([materials.white, *materials.woods])
    if corner is not None:
        shell.groups.append([box((corner[0], x[1]), (0, height), (corner[1], z[1]), common)])
    if kind.shape == "open":
        z = (depth / 2 - 0.2, depth / 2 + 0.2)
        for x in ((width * share - 0.2, width * share + 0.2) for share in (0.33, 0.67)):
            shell.pillars.append((*x, *z))
            shell.groups.append([box(x, (0, height), z, common)])
    doorway = random.integers(_OUTER_WALLS)
    for i, wall in enumerate(shell.walls):
        material = common if random.random() < 0.8 else materials.wall()
        size, holes = (wall.length, height), []
        if i < _OUTER_WALLS:  # the others are sides of the solid box in the corner
            holes = (openings.doorway if i == doorway else openings.windows)(random, size)
            parts = openings.wall_parts(size, holes, material)
            shell.groups.append(wall.to_room(parts))
        _furnish_wall(random, materials, shell, wall, holes, trim)
    return shell


def _furnish_wall(
    random: np.random.Generator,
    materials: Materials,
    shell: Shell,
    wall: Wall,
    holes: list[Opening],
    trim: Material,
) -> None:
    """Add windows, the room behind a doorway, radiators, skirting and a closed door."""
    for hole in holes:
        wall.reserve(*hole[:4])
        make = openings.next_room if hole.is_door else openings.window
        shell.groups.append(wall.to_room(make(random, materials, hole, shell.height, trim)))
        shell.windows.extend([] if hole.is_door else [(wall, hole)])
        s = (hole.left + hole.right) / 2
        if random.random() < 0.5 and wall.reserve(s - 0.5, s + 0.5, 0.0, 0.75):
            shell.groups.append(
                wall.to_room([part.moved((s, 0, 0)) for part in openings.radiator(materials)])
            )
    shell.groups.append(wall.to_room(openings.skirting(wall.length, holes, trim)))
    s = random.uniform(-0.5, 0.5) * (wall.length - DOOR_SIZE_M[0])
    half = DOOR_SIZE_M[0] / 2
    if (not holes or random.random() < 0.3) and wall.reserve(s - half, s + half, 0, DOOR_SIZE_M[1]):
        door = openings.closed_door(random, materials, trim)
        shell.groups.append(wall.to_room([part.moved((s, 0, 0)) for part in door]))


def _walls(width: float, depth: float, corner: tuple[float, float] | None) -> list[Wall]:
    x, z = corner or (width, depth)
    walls = [
        Wall((width / 2, 0, 0), 0, width),
        Wall((0, 0, depth / 2), 90, depth),
        Wall((x / 2, 0, depth), 180, x),
        Wall((width, 0, z / 2), 270, z),
    ]
    if corner is not None:
        walls.append(Wall(((width + x) / 2, 0, z), 180, width - x))
        walls.append(Wall((x, 0, (depth + z) / 2), 270, depth - z))
    return walls
