"""Make docs/estimates.jpg: rendered rooms, their true depth, and what the default model estimates.

Run ``python docs/draw_estimates.py``. One room is of the better half, in the other the model is
wrong. Colours are those of the true depth's span; the numbers are medians.
"""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import depthcli
from depthcli.core.options import Colormap
from depthcli.datasets.rooms.render import TYPICAL_HFOV_DEG, Pair, RoomSettings, render_pair
from depthcli.io.formats.preview import colour_table, contact_sheet

TARGET = Path(__file__).with_name("estimates.jpg")
SETTINGS = RoomSettings(seed=9, size=(640, 480), hfov_deg=(TYPICAL_HFOV_DEG, TYPICAL_HFOV_DEG))
ROOMS = (6, 12)
SHOWN_PX = 320, 240


def estimated(room: Pair) -> npt.NDArray[np.float32]:
    """Depth by the default model, (480, 640) metres."""
    model = depthcli.load_model("default", provider="cpu")
    return model.predict(room.rgb, hfov_deg=TYPICAL_HFOV_DEG).values


def drawn(
    depth_m: npt.NDArray[np.float32], span_m: npt.NDArray[np.float32]
) -> npt.NDArray[np.uint8]:
    """Depth in the colours of another map's span, with its median: (240, 320, 3)."""
    near, far = np.quantile(1 / span_m[span_m > 0], (0.98, 0.02))
    nearness = np.clip((1 / np.maximum(depth_m, 1e-3) - far) / (near - far), 0, 1)
    nearness[depth_m <= 0] = 0  # black where nothing is known, such as windows
    coloured = colour_table(Colormap.INFERNO)[np.rint(nearness * 255).astype(np.uint8)]
    small = cv2.resize(coloured, SHOWN_PX, interpolation=cv2.INTER_AREA)
    told = f"{np.median(depth_m[span_m > 0]):.2f} m"
    for colour, width in (((0, 0, 0), 4), ((255, 255, 255), 1)):
        cv2.putText(
            small, told, (8, 232), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, width, cv2.LINE_AA
        )
    return np.asarray(small, np.uint8)


def main() -> None:
    """Render, predict and write the picture."""
    rows = []
    for number in ROOMS:
        room = render_pair(SETTINGS, number)
        small = cv2.resize(room.rgb, SHOWN_PX, interpolation=cv2.INTER_AREA)
        maps = (room.depth_m, estimated(room))
        rows.append([np.asarray(small), *(drawn(depth_m, room.depth_m) for depth_m in maps)])
    sheet = cv2.cvtColor(contact_sheet(rows, ["room", "depth", "estimate"]), cv2.COLOR_RGB2BGR)
    TARGET.write_bytes(cv2.imencode(".jpg", sheet, (cv2.IMWRITE_JPEG_QUALITY, 88))[1].tobytes())


if __name__ == "__main__":
    main()
