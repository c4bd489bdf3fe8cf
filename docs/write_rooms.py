"""Make docs/rooms.jpg: sixteen rendered rooms, with the depth of half of them.

Run ``python docs/write_rooms.py`` after a change of the rooms. They are rendered again, from
the same seed.
"""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.options import Colormap
from depthcli.datasets.rooms.render import RoomSettings, render_pair
from depthcli.io.formats.preview import colour_table

TARGET = Path(__file__).with_name("rooms.jpg")
SETTINGS = RoomSettings(seed=1, size=(256, 192))
ACROSS, WITH_DEPTH, WITHOUT = 4, 8, 8


def coloured(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Near is bright, and black is no depth."""
    nearness = np.where(depth_m > 0, 0.8 / np.maximum(depth_m, 0.8), 0)
    return colour_table(Colormap.INFERNO)[np.rint(nearness * 255).astype(np.uint8)]


def main() -> None:
    """Write the picture."""
    pairs = [render_pair(SETTINGS, i) for i in range(WITH_DEPTH + WITHOUT)]
    pictures = [pair.rgb for pair in pairs]
    depths = [coloured(pair.depth_m) for pair in pairs[:WITH_DEPTH]]
    rows = []
    for first in range(0, len(pairs), ACROSS):
        rows.append(np.hstack(pictures[first : first + ACROSS]))
        rows.extend([np.hstack(depths[first : first + ACROSS])] if first < WITH_DEPTH else [])
    sheet = cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR)
    TARGET.write_bytes(cv2.imencode(".jpg", sheet, (cv2.IMWRITE_JPEG_QUALITY, 85))[1].tobytes())


if __name__ == "__main__":
    main()
