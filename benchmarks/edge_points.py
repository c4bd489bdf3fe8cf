"""Points between near and far, of rendered rooms whose exact depth was reduced and upsampled.

python benchmarks/edge_points.py --rooms 8
"""

import argparse

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import resize_area, upsample_guided
from depthcli.core.options import Sensor
from depthcli.core.surface import is_flying
from depthcli.core.types import Frame
from depthcli.datasets.rooms.render import RoomSettings, render_pair, room_focal_px

SIZE, NETWORK_SIZE = (640, 480), (256, 192)
REACH_PX = 4
OFF_M = 0.1


def off_surface(
    depth_m: npt.NDArray[np.float32], exact_m: npt.NDArray[np.float32]
) -> npt.NDArray[np.bool_]:
    """Where depth is more than ``OFF_M`` off that of every pixel near; (H, W) bool."""
    height, width = exact_m.shape
    around = np.pad(exact_m, REACH_PX, mode="edge")
    shifts = [(y, x) for y in range(2 * REACH_PX + 1) for x in range(2 * REACH_PX + 1)]
    nearest_m = np.full(depth_m.shape, np.inf, np.float32)
    for y, x in shifts:
        np.fmin(nearest_m, abs(depth_m - around[y : y + height, x : x + width]), out=nearest_m)
    return nearest_m > OFF_M


def shares(settings: RoomSettings, room: int) -> tuple[float, float, float]:
    """Shares of points off a surface: of all, of those that are left; and of others that go."""
    pair = render_pair(settings, room)
    exact_m = pair.depth_m.astype(np.float32)
    is_sky = exact_m <= 0
    exact_m[is_sky] = exact_m.max()
    counted = cv2.dilate(is_sky.astype(np.uint8), np.ones((4 * REACH_PX + 1,) * 2, np.uint8)) == 0
    small_m = resize_area(exact_m, *NETWORK_SIZE)
    depth_m = upsample_guided(small_m, Frame(np.ascontiguousarray(pair.rgb)), in_log=True)
    is_off = off_surface(depth_m, exact_m)[counted]
    gone = is_flying(depth_m, room_focal_px(settings, room))[counted]
    return float(is_off.mean()), float(is_off[~gone].mean()), float(gone[~is_off].mean())


def main() -> None:
    """Print the mean over rooms of two cameras."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=8)
    count = parser.parse_args().rooms
    cv2.setNumThreads(1)
    found = [
        shares(RoomSettings(0, SIZE, (hfov, hfov), Sensor.NONE), room)
        for hfov in (60, 90)
        for room in range((count + 1) // 2)
    ]
    before, after, lost = np.mean(found, 0)
    print(f"off any surface: {before:.2%} of all points, {after:.2%} of those that are left")
    print(f"left out of the others: {lost:.2%}")


if __name__ == "__main__":
    main()
