"""Picture and depth of one rendered room: the same for the same recipe and number, anywhere."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core import scaling
from depthcli.core.choices import Sensor
from depthcli.datasets.rooms.camera import place_camera
from depthcli.datasets.rooms.furnish import make_room
from depthcli.datasets.rooms.render import Renderer
from depthcli.datasets.rooms.sensor import kinect, photograph

VERSION = 1
"""Goes up when the same recipe gives other pictures."""
USUAL_HFOV_DEG = 63.0


class Recipe(NamedTuple):
    """What rooms follow from."""

    seed: int = 0
    size: tuple[int, int] = (256, 192)  #: width and height, px
    hfov_deg: tuple[float, float] = (30.0, 110.0)  #: narrowest and widest, degrees across
    sensor: Sensor = Sensor.NONE


class Pair(NamedTuple):
    """One picture and its depth."""

    rgb: npt.NDArray[np.uint8]  #: (H, W, 3)
    depth_m: npt.NDArray[np.float32]  #: (H, W) metres along the camera axis, 0 where there is none


def room_focal_px(recipe: Recipe, index: int) -> float:
    """Focal length of a room's camera in pixels, known without rendering."""
    low, high = recipe.hfov_deg
    usual = min(max(USUAL_HFOV_DEG, low), high)
    random = _random(recipe, index, 0)
    hfov_deg = random.triangular(low, usual, high) if low < high else low
    return scaling.focal_px_of_hfov(hfov_deg, recipe.size[0])


def render_pair(recipe: Recipe, index: int) -> Pair:
    """Build, furnish, light and photograph a room.

    Args:
        recipe: what all rooms have in common.
        index: which room, from 0.
    """
    random = _random(recipe, index, 1)
    room = make_room(random)
    solids = room.solids
    camera = place_camera(random, room, solids, room_focal_px(recipe, index), recipe.size)
    view = Renderer(room, solids, camera, random).view()
    rgb = photograph(view.light, random)
    return Pair(rgb, kinect(view, random) if recipe.sensor is Sensor.KINECT else view.depth_m)


def _random(recipe: Recipe, index: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng([recipe.seed, index, purpose])
