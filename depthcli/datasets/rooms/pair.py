"""Picture and depth of one rendered room, reproducible from its settings and number."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import focal_px_of_hfov
from depthcli.core.choices import Sensor
from depthcli.datasets.rooms.camera import place_camera
from depthcli.datasets.rooms.furnish import make_room
from depthcli.datasets.rooms.render import Renderer
from depthcli.datasets.rooms.sensor import kinect, photograph

VERSION = 2
"""Increases when the same settings give other pictures."""
TYPICAL_HFOV_DEG = 63.0


class RoomSettings(NamedTuple):
    """The settings that all rooms of a data set depend on."""

    seed: int = 0
    size: tuple[int, int] = (256, 192)  #: width and height, px
    hfov_deg: tuple[float, float] = (30.0, 110.0)  #: narrowest and widest, degrees across
    sensor: Sensor = Sensor.NONE


class Pair(NamedTuple):
    """One picture and its depth."""

    rgb: npt.NDArray[np.uint8]  #: (H, W, 3)
    depth_m: npt.NDArray[np.float32]  #: (H, W) metres along the camera axis, 0 where there is none


def room_focal_px(settings: RoomSettings, index: int) -> float:
    """Focal length of a room's camera in pixels, without rendering."""
    low, high = settings.hfov_deg
    typical = min(max(TYPICAL_HFOV_DEG, low), high)
    random = _random(settings, index, 0)
    hfov_deg = random.triangular(low, typical, high) if low < high else low
    return focal_px_of_hfov(hfov_deg, settings.size[0])


def render_pair(settings: RoomSettings, index: int) -> Pair:
    """Build, furnish, light and render a room.

    Args:
        settings: of all rooms.
        index: number of the room, from 0.
    """
    random = _random(settings, index, 1)
    room = make_room(random)
    solids = room.solids
    focal_px = room_focal_px(settings, index)
    camera = place_camera(random, room, solids, focal_px, settings.size)
    view = Renderer(room, solids, camera, random).view()
    rgb = photograph(view.light, random)
    if settings.sensor is Sensor.KINECT:
        return Pair(rgb, kinect(view, focal_px, random))
    return Pair(rgb, view.depth_m)


def _random(settings: RoomSettings, index: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng([settings.seed, index, purpose])
