"""A piece of furniture, and parts that several of them share.

Each piece stands on y = 0, is centred on x = 0, has its back at z = 0 and faces along z.
"""

from typing import NamedTuple

from depthcli.datasets.rooms.materials import Material
from depthcli.datasets.rooms.solids import Part, centred_box


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
    """The same box at the left and at the right."""
    return [centred_box(half, y, z, material).moved((side, 0, 0)) for side in (-x, x)]
