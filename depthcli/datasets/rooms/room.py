"""Placing furniture and pictures in a room."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from depthcli.datasets.rooms.furniture import PIECES, Piece
from depthcli.datasets.rooms.materials import Material, Materials
from depthcli.datasets.rooms.solids import (
    CYLINDER_Y,
    CYLINDER_Z,
    Part,
    Solids,
    Vector,
    box,
    centred_box,
    rotation,
)

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


class RoomType(NamedTuple):
    """Size, furniture and shape of a type of room."""

    sides_m: tuple[tuple[float, float], tuple[float, float]]  #: range of width and of depth
    furniture: str  #: pieces of furniture, most important first
    shape: Literal["", "L", "open"] = ""  #: ``L`` may lack a corner; ``open`` has pillars


ROOM_TYPES = {
    "living": RoomType(
        ((2.8, 5.5), (3.5, 8)),
        "sofa television sofa table shelf round_table cupboard plant floor_lamp chair bin_or_box",
        "L",
    ),
    "bedroom": RoomType(
        ((2.5, 4.5), (3, 5.5)), "bed cupboard desk shelf chair floor_lamp cupboard plant", "L"
    ),
    "kitchen": RoomType(
        ((2, 4.5), (2.6, 6)), "counter fridge counter table round_table cupboard chair bin_or_box"
    ),
    "bathroom": RoomType(
        ((2, 2.8), (2, 4)), "bathtub basin toilet fridge bin_or_box cupboard plant"
    ),
    "office": RoomType(
        ((2.8, 7), (3.5, 10)),
        "desk desk shelf desk cupboard desk shelf office_chair plant table bin_or_box bin_or_box",
        "L",
    ),
    "study": RoomType(
        ((2.2, 4), (2.5, 5)), "desk shelf shelf sofa office_chair bin_or_box floor_lamp", "L"
    ),
    "corridor": RoomType(((1.3, 2.4), (4, 12)), "cupboard plant bin_or_box chair"),
    "hall": RoomType(
        ((5, 9), (6, 12)),
        "table table round_table table sofa shelf television sofa cupboard plant plant bin_or_box",
        "open",
    ),
    "library": RoomType(
        ((3, 7), (4, 11)), "shelf shelf shelf shelf table shelf shelf desk shelf sofa chair", "L"
    ),
}
"""Types of rooms by name."""


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
    entrance = random.integers(_OUTER_WALLS)
    for i, wall in enumerate(shell.walls):
        material = common if random.random() < 0.8 else materials.wall()
        size, openings = (wall.length, height), []
        if i < _OUTER_WALLS:  # the others are sides of the solid box in the corner
            openings = (doorway if i == entrance else windows)(random, size)
            parts = wall_parts(size, openings, material)
            shell.groups.append(wall.to_room(parts))
        _furnish_wall(random, materials, shell, wall, openings, trim)
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
        make = next_room if hole.is_door else window
        shell.groups.append(wall.to_room(make(random, materials, hole, shell.height, trim)))
        shell.windows.extend([] if hole.is_door else [(wall, hole)])
        s = (hole.left + hole.right) / 2
        if random.random() < 0.5 and wall.reserve(s - 0.5, s + 0.5, 0.0, 0.75):
            shell.groups.append(
                wall.to_room([part.moved((s, 0, 0)) for part in radiator(materials)])
            )
    shell.groups.append(wall.to_room(skirting(wall.length, holes, trim)))
    s = random.uniform(-0.5, 0.5) * (wall.length - DOOR_SIZE_M[0])
    half = DOOR_SIZE_M[0] / 2
    if (not holes or random.random() < 0.3) and wall.reserve(s - half, s + half, 0, DOOR_SIZE_M[1]):
        door = closed_door(random, materials, trim)
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
