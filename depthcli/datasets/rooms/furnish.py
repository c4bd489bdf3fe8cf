"""Placing furniture and pictures in a room."""

from dataclasses import dataclass, field

import numpy as np

from depthcli.datasets.rooms.furniture import PIECES
from depthcli.datasets.rooms.layout import Shell, build_shell
from depthcli.datasets.rooms.lighting import Light, ceiling_lamps, daylight
from depthcli.datasets.rooms.materials import Materials
from depthcli.datasets.rooms.piece import Piece
from depthcli.datasets.rooms.room_types import ROOM_TYPES
from depthcli.datasets.rooms.solids import (
    CYLINDER_Y,
    CYLINDER_Z,
    Part,
    Solids,
    Vector,
    centred_box,
    rotation,
)

_TRIES = 20
_CHAIRS = {"desk": "office_chair", "table": "chair", "round_table": "chair"}


@dataclass(slots=True)
class Room:
    """A furnished room."""

    shell: Shell
    materials: Materials
    is_day: bool  #: whether it is bright outdoors
    names: list[str] = field(default_factory=list)  #: pieces of furniture in it
    groups: list[list[Part]] = field(default_factory=list)  #: their solids
    tabletops: list[Vector] = field(default_factory=list)  #: centres of surfaces with objects
    lights: list[Light] = field(default_factory=list)
    #: (low x, high x, low z, high z) of furniture on the floor and of pillars, metres
    occupied: list[tuple[float, float, float, float]] = field(default_factory=list)

    @property
    def solids(self) -> Solids:
        """All solids of the room, for ray casting."""
        return Solids([*self.shell.groups, *self.groups])


def make_room(random: np.random.Generator, kind: str = "") -> Room:
    """A room of a type; of a random type if none is given."""
    materials = Materials(random)
    kind = kind or str(random.choice(list(ROOM_TYPES)))
    shell = build_shell(random, materials, kind)
    is_day = bool(random.random() < 0.75)
    room = Room(shell, materials, is_day, occupied=[*shell.pillars])
    for name in shell.kind.furniture.split():
        if random.random() < 0.95:
            _place_piece(random, room, name)
    _hang_pictures(random, room)
    if room.is_day:
        room.lights += [daylight(random, wall, hole) for wall, hole in shell.windows]
    if not room.lights or random.random() < 0.6:
        lights, parts = ceiling_lamps(random, materials, shell)
        room.lights += lights
        room.groups.append(parts)
    if random.random() < 0.5:
        _lay_rug(random, room)
    return room


def _place_piece(random: np.random.Generator, room: Room, name: str) -> None:
    """Place a piece with its chairs, free on the floor or against a wall, if there is room."""
    piece = PIECES[name](random, room.materials)
    is_free = name.endswith("chair") or (name.endswith("table") and random.random() < 0.7)
    for _ in range(_TRIES):
        place = (_on_the_floor if is_free else _at_a_wall)(random, room, piece)
        if place is not None:
            room.names.append(name)
            if name in _CHAIRS and piece.top > 0.6:
                sides = (0, 90, 180, 270) if is_free else (0,)
                _place_chairs(random, room, piece, place, _CHAIRS[name], sides)
            return


def _on_the_floor(
    random: np.random.Generator, room: Room, piece: Piece
) -> tuple[Vector, float] | None:
    x, z = (random.uniform(0.5, side - 0.5) for side in (room.shell.width, room.shell.depth))
    yaw_deg = 90 * random.integers(4) + random.normal(0, 8)
    return ((x, 0.0, z), yaw_deg) if _place_if_free(room, piece, (x, 0.0, z), yaw_deg) else None


def _at_a_wall(
    random: np.random.Generator, room: Room, piece: Piece
) -> tuple[Vector, float] | None:
    wall, half = room.shell.walls[random.integers(len(room.shell.walls))], piece.width / 2
    s = random.uniform(-1, 1) * max(0.0, wall.length / 2 - half)
    if not wall.reserve(s - half, s + half, 0.0, piece.height):
        return None
    x, y, z = rotation(wall.yaw_deg, 1) @ np.array([s, 0.0, 0.02]) + wall.middle
    if _place_if_free(room, piece, (x, y, z), wall.yaw_deg):
        return (x, y, z), wall.yaw_deg
    wall.occupied.pop()
    return None


def _place_if_free(room: Room, piece: Piece, at: Vector, yaw_deg: float, gap: float = 0.0) -> bool:
    """Place a piece unless it would overlap another one or a wall by more than a gap."""
    half, shell = piece.width / 2, room.shell
    corners = np.array([[-half, half, half, -half], [0] * 4, [0, 0, piece.depth, piece.depth]])
    x, _, z = rotation(yaw_deg, 1) @ corners + np.array(at)[:, None]
    low_x, high_x, low_z, high_z = x.min() + gap, x.max() - gap, z.min() + gap, z.max() - gap
    outside = low_x < 0 or low_z < 0 or high_x > shell.width or high_z > shell.depth
    if outside or (shell.corner and high_x > shell.corner[0] and high_z > shell.corner[1]):
        return False
    if any(low_x < b and high_x > a and low_z < d and high_z > c for a, b, c, d in room.occupied):
        return False
    room.occupied.append((low_x, high_x, low_z, high_z))
    room.groups.append([part.moved(at, yaw_deg) for part in piece.parts])
    room.tabletops += [(x.mean(), piece.top, z.mean())] if piece.top else []
    return True


def _place_chairs(
    random: np.random.Generator,
    room: Room,
    piece: Piece,
    place: tuple[Vector, float],
    name: str,
    sides: tuple[int, ...],
) -> None:
    """Place chairs at some sides of a table, facing it approximately."""
    at, yaw_deg = place
    for side in sides:
        chair = PIECES[name](random, room.materials)
        under = random.uniform(0.05, 0.3) if name == "chair" else 0.0
        reach = (piece.depth if side % 180 == 0 else piece.width) / 2
        back = rotation(side, 1) @ np.array([0, 0, reach + chair.depth + 0.02 - under])
        back[2] += piece.depth / 2
        x, y, z = rotation(yaw_deg, 1) @ back + at
        yaw = yaw_deg + side + 180 + random.normal(0, 12)
        if random.random() < 0.7 and _place_if_free(room, chair, (x, y, z), yaw, gap=0.15):
            room.names.append(name)


def _hang_pictures(random: np.random.Generator, room: Room) -> None:
    """Hang pictures, boards, mirrors and clocks on free parts of the walls."""
    materials, parts = room.materials, []
    for wall in room.shell.walls:
        for _ in range(random.integers(0, 5)):
            half, tall = random.uniform(0.12, 0.6), random.uniform(0.15, 0.45)
            s, y = random.uniform(-0.5, 0.5) * wall.length, random.uniform(1.35, 1.8)
            if not wall.reserve(s - half, s + half, y - tall, y + tall):
                continue
            deep, edge = random.uniform(0.01, 0.04), random.uniform(0.01, 0.05)
            frame = materials.pick([materials.black, materials.white, *materials.woods])
            inside = (
                materials.mirror if random.random() < 0.12 else materials.art(2 * max(half, tall))
            )
            hung = [
                Part((0, y, deep / 2), (half, tall, deep / 2), frame),
                centred_box(
                    half - edge, (y - tall + edge, y + tall - edge), (0, deep + 0.002), inside
                ),
            ]
            if random.random() < 0.1:
                hung = [Part((0, y, deep), (0.15, 0.15, deep), materials.white, CYLINDER_Z)]
            parts += wall.to_room([part.moved((s, 0, 0)) for part in hung])
    room.groups.append(parts)


def _lay_rug(random: np.random.Generator, room: Room) -> None:
    half, shell = random.uniform(0.5, 1.2, 2), room.shell
    x, z = random.uniform(0.3, 0.7, 2) * (shell.width, shell.depth)
    material = (
        room.materials.fabric() if random.random() < 0.4 else room.materials.rug(2 * half.max())
    )
    is_round = random.random() < 0.2
    rug = Part(
        (x, 0.005, z), (half[0], 0.005, half[1]), material, CYLINDER_Y if is_round else (0, 0, 0)
    )
    room.groups.append([rug.tilted(random.normal(0, 10), 1)])
