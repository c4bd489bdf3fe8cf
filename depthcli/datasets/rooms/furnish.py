"""Where furniture, pictures and lamps go in a room."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from depthcli.datasets.rooms.furniture import PIECES, Piece
from depthcli.datasets.rooms.layout import KINDS, Shell, Wall, build_shell
from depthcli.datasets.rooms.looks import Looks
from depthcli.datasets.rooms.solids import UPRIGHT, Part, Solids, Vector, box, rotation

_TRIES = 20
_SEATS = {"desk": "office_chair", "table": "chair", "round_table": "chair"}


class Light(NamedTuple):
    """A lamp, or a window by day.

    Attributes:
        centre: metres.
        across: half of its extent in two directions, (2, 3) metres.
        power: radiance times area.
        tint: its colour, about 1.
        facing: direction in which it shines; zeros for all around.
    """

    centre: Vector
    across: tuple[Vector, Vector]
    power: float
    tint: Vector
    facing: Vector = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Room:
    """A furnished room.

    Attributes:
        kind: its sort, of :data:`~depthcli.datasets.rooms.layout.KINDS`.
        names: pieces of furniture in it.
        tops: (x, y, z) metres of surfaces with things on them.
        is_day: it is bright outdoors.
    """

    kind: str
    shell: Shell
    looks: Looks
    is_day: bool
    names: list[str] = field(default_factory=list)
    groups: list[list[Part]] = field(default_factory=list)
    tops: list[Vector] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    @property
    def solids(self) -> Solids:
        """Everything, ready to be searched."""
        return Solids([*self.shell.groups, *self.groups])


def make_room(random: np.random.Generator, kind: str = "") -> Room:
    """A room of a sort; of any sort if none is named."""
    looks = Looks(random)
    kind = kind or str(random.choice(list(KINDS)))
    shell = build_shell(random, looks, kind)
    room = Room(kind, shell, looks, is_day=bool(random.random() < 0.75))
    for wish in shell.kind.wishes.split():
        if random.random() < 0.95:
            _place(random, room, wish)
    _hang_pictures(random, room)
    _light(random, room)
    if random.random() < 0.5:
        _lay_rug(random, room)
    return room


def _place(random: np.random.Generator, room: Room, name: str) -> None:
    """A piece against a wall or free on the floor, with its chairs, where there is room."""
    shell, piece = room.shell, PIECES[name](random, room.looks)
    free = name in ("chair", "office_chair") or (
        name in ("table", "round_table") and random.random() < 0.7
    )
    for _ in range(_TRIES):
        if free:
            at = (
                random.uniform(0.5, shell.width - 0.5),
                0.0,
                random.uniform(0.5, shell.depth - 0.5),
            )
            yaw = 90.0 * random.integers(4) + random.normal(0, 8)
            if _stand(room, piece, at, yaw):
                break
        else:
            wall = shell.walls[random.integers(len(shell.walls))]
            s = random.uniform(-0.5, 0.5) * max(0.0, wall.length - piece.width)
            span = (s - piece.width / 2, s + piece.width / 2, 0.0, piece.height)
            before = len(wall.taken)
            if not wall.take(*span):
                continue
            x, _, z = rotation(wall.yaw_deg, 1) @ np.array([s, 0.0, 0.02])
            at, yaw = (wall.middle[0] + x, 0.0, wall.middle[2] + z), np.float64(wall.yaw_deg)
            if _stand(room, piece, at, yaw):
                break
            del wall.taken[before:]
    else:
        return
    room.names.append(name)
    if name in _SEATS:
        _seat(random, room, piece, at, yaw, _SEATS[name], all_round=free)


def _stand(room: Room, piece: Piece, at: Vector, yaw_deg: float, gap: float = 0.0) -> bool:
    """Put a piece there unless something else or a wall is in its way."""
    half = piece.width / 2
    corners = np.array([[-half, half, half, -half], [0] * 4, [0, 0, piece.depth, piece.depth]])
    x, _, z = rotation(yaw_deg, 1) @ corners + np.array(at)[:, None]
    low_x, high_x, low_z, high_z = x.min() + gap, x.max() - gap, z.min() + gap, z.max() - gap
    shell = room.shell
    if low_x < 0 or low_z < 0 or high_x > shell.width or high_z > shell.depth:
        return False
    if shell.corner and high_x > shell.corner[0] and high_z > shell.corner[1]:
        return False
    if any(low_x < b and high_x > a and low_z < d and high_z > c for a, b, c, d in room.taken):
        return False
    room.taken.append((low_x, high_x, low_z, high_z))
    room.groups.append([part.moved(at, yaw_deg) for part in piece.parts])
    if piece.top:
        room.tops.append((float(x.mean()), piece.top, float(z.mean())))
    return True


def _seat(
    random: np.random.Generator,
    room: Room,
    piece: Piece,
    at: Vector,
    yaw_deg: float,
    name: str,
    *,
    all_round: bool,
) -> None:
    """Chairs at a table, each turned towards it, not quite straight."""
    middle = np.array([0.0, 0.0, piece.depth / 2])
    for side in (0, 90, 180, 270) if all_round else (0,):
        if piece.top < 0.6 or random.random() < 0.3:
            continue
        chair = PIECES[name](random, room.looks)
        reach = (piece.depth if side % 180 == 0 else piece.width) / 2
        away = reach + chair.depth - random.uniform(0.05, 0.3) * (name == "chair") + 0.02
        # The chair's back is away from the table.
        place = middle + rotation(side, 1) @ np.array([0, 0, away])
        x, y, z = rotation(yaw_deg, 1) @ place + np.array(at)
        if _stand(room, chair, (x, y, z), yaw_deg + side + 180 + random.normal(0, 12), gap=0.15):
            room.names.append(name)


def _hang_pictures(random: np.random.Generator, room: Room) -> None:
    """Pictures, boards, mirrors, clocks, on free parts of the walls."""
    looks, parts = room.looks, []
    for wall in room.shell.walls:
        for _ in range(random.integers(0, 5)):
            half, tall = random.uniform(0.12, 0.6), random.uniform(0.15, 0.45)
            s, y = random.uniform(-0.5, 0.5) * wall.length, random.uniform(1.35, 1.8)
            if not wall.take(s - half, s + half, y - tall, y + tall):
                continue
            frame = looks.pick([looks.black, looks.white, *looks.woods])
            inside = looks.art()._replace(tile_m=2.05 * max(half, tall))
            if random.random() < 0.12:
                inside = looks.mirror
            deep, edge = random.uniform(0.01, 0.04), random.uniform(0.01, 0.05)
            if random.random() < 0.1:
                hung = [Part((s, y, deep), (tall / 2, tall / 2, deep), looks.white, (1, 1, 0))]
            else:
                hung = [
                    box((s - half, s + half), (y - tall, y + tall), (0, deep), frame),
                    box(
                        (s - half + edge, s + half - edge),
                        (y - tall + edge, y + tall - edge),
                        (0, deep + 0.002),
                        inside,
                    ),
                ]
            parts += wall.put(hung)
    room.groups.append(parts)


def _light(random: np.random.Generator, room: Room) -> None:
    """Lamps at the ceiling, and windows by day."""
    shell, parts = room.shell, []
    warm = random.uniform(0.6, 1.0)
    area = shell.width * shell.depth
    if not (room.is_day and shell.windows) or random.random() < 0.6:
        count = max(1, round(max(shell.width, shell.depth) / random.uniform(3, 5)))
        for i in range(count):
            share, half = (i + 0.5) / count, random.uniform(0.1, 0.3)
            x, z = (share, 0.5) if shell.width > shell.depth else (0.5, share)
            drop = (
                random.uniform(0.05, 0.7) if shell.height > 2.4 and random.random() < 0.5 else 0.06
            )
            centre = (x * shell.width, shell.height - drop, z * shell.depth)
            # Just below its body, which else would shade the room.
            power = random.uniform(0.6, 1.4) * area / count
            low = (centre[0], centre[1] - 0.08, centre[2])
            room.lights.append(
                Light(low, ((half, 0, 0), (0, 0, half)), power, (1.1, 0.8 + 0.2 * warm, warm))
            )
            parts.append(Part(centre, (half, 0.05, half), room.looks.lamp, UPRIGHT))
            if drop > 0.06:
                rod = (shell.height - centre[1]) / 2
                parts.append(
                    Part(
                        (centre[0], centre[1] + rod, centre[2]),
                        (0.008, rod, 0.008),
                        room.looks.black,
                    )
                )
    for wall, hole in shell.windows if room.is_day else ():
        room.lights.append(_daylight(random, wall, hole))
    if parts:
        room.groups.append(parts)


def _daylight(random: np.random.Generator, wall: Wall, hole: tuple[float, ...]) -> Light:
    turn = rotation(wall.yaw_deg, 1)
    left, right, low, high = hole[:4]
    middle = turn @ np.array([(left + right) / 2, (low + high) / 2, -0.05]) + wall.middle
    across = turn @ np.array([(right - left) / 2, 0, 0])
    power = random.uniform(2.0, 6.0) * (right - left) * (high - low)
    facing = turn @ np.array([0.0, 0.0, 1.0])
    return Light(
        tuple(middle),
        (tuple(across), (0, (high - low) / 2, 0)),
        power,
        (0.92, 0.97, 1.05),
        tuple(facing),
    )


def _lay_rug(random: np.random.Generator, room: Room) -> None:
    shell, half = room.shell, random.uniform(0.5, 1.2, 2)
    x, z = (random.uniform(0.3, 0.7) * side for side in (shell.width, shell.depth))
    look = room.looks.fabric() if random.random() < 0.4 else room.looks.rug(2 * half.max())
    rug = Part(
        (x, 0.005, z),
        (half[0], 0.005, half[1]),
        look,
        UPRIGHT if random.random() < 0.2 else (0, 0, 0),
    )
    room.groups.append([rug.tilted(random.normal(0, 10), 1)])
