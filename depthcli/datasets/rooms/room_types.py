"""Types of rooms: their size, shape and furniture."""

from typing import Literal, NamedTuple


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
