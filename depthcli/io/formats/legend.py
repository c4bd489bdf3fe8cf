"""A colour bar with tick labels."""

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthKind

_MAX_TICKS = 5
_TICK_HEIGHT = 20  # of a label, at the reference height
_MIN_ROOM = 0.6  # closer labels touch
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_REFERENCE_HEIGHT = 480  # at this height the scale is 1
_THOUSAND = 1000
_MIN_SIZE = 0.9  # smaller text loses its decimal points


def with_legend(
    image: npt.NDArray[np.uint8],
    colours: npt.NDArray[np.uint8],
    near: float,
    far: float,
    kind: DepthKind,
) -> npt.NDArray[np.uint8]:
    """The image (H, W, 3) RGB uint8 with a colour bar at its right, near at the top.

    Colours are (256, 3) RGB uint8, far first; metric maps are labelled in metres.
    """
    height = image.shape[0]
    size = float(np.clip(height / _REFERENCE_HEIGHT, _MIN_SIZE, 4))
    margin, bar_width, width = (round(n * size) for n in (16, 20, 104))
    top = min(margin, height // 4)
    bar_height = max(1, height - 2 * top)
    panel = np.full((height, width, 3), 24, np.uint8)
    shades = colours[np.linspace(255, 0, bar_height).round().astype(int)]
    bar = panel[top : top + bar_height, margin : margin + bar_width]
    bar[:] = shades[: len(bar), np.newaxis]
    for share in _ticks(bar_height / (_TICK_HEIGHT * size), flat=near == far):
        y = top + round(share * (bar_height - 1))
        text = label(tick_value(1 - share, near, far, kind), kind)
        _draw(panel, text, (margin + bar_width + round(7 * size), y + round(5 * size)), size)
    return np.hstack([image, panel])


def _ticks(room: float, *, flat: bool) -> npt.NDArray[np.float64]:
    """Positions of the ticks that fit, 0 at the near end; one if both ends are the same.

    ``room`` is the number of labels that fit below the first one.
    """
    if flat or room < _MIN_ROOM:
        return np.array([0.5])
    return np.linspace(0, 1, int(np.clip(1 + room, 2, _MAX_TICKS)))


def tick_value(nearness: float, near: float, far: float, kind: DepthKind) -> float:
    """The value at a position of the bar, 1 at the near end; inverse of the preview's mapping."""
    if kind is DepthKind.METRIC and near > 0:
        return 1 / (nearness / near + (1 - nearness) / far)
    return nearness * near + (1 - nearness) * far


def label(value: float, kind: DepthKind) -> str:
    """Three significant digits, or whole thousands, with the unit where there is one."""
    if abs(value) < _THOUSAND - 0.5:
        digits = f"{value:#.3g}".rstrip(".")
    else:
        digits = f"{value:.0f}" if abs(value) < 100 * _THOUSAND else f"{value:.2g}"
    return f"{digits} m" if kind is DepthKind.METRIC else digits


def _draw(panel: npt.NDArray[np.uint8], text: str, origin: tuple[int, int], size: float) -> None:
    thickness = max(1, round(size))
    cv2.putText(panel, text, origin, _FONT, 0.45 * size, (235, 235, 235), thickness, cv2.LINE_AA)
