"""Colour tables from far to near."""

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.options import Colormap, Near

_OPENCV = {
    Colormap.INFERNO: cv2.COLORMAP_INFERNO,
    Colormap.TURBO: cv2.COLORMAP_TURBO,
    Colormap.MAGMA: cv2.COLORMAP_MAGMA,
    Colormap.VIRIDIS: cv2.COLORMAP_VIRIDIS,
}
# ColorBrewer's Spectral, 11 classes (Brewer 2003, Apache-2.0 colour specifications), blue to red.
_SPECTRAL = (
    (94, 79, 162), (50, 136, 189), (102, 194, 165), (171, 221, 164), (230, 245, 152),
    (255, 255, 191), (254, 224, 139), (253, 174, 97), (244, 109, 67), (213, 62, 79), (158, 1, 66),
)  # fmt: skip
_LEVELS = 256


def colour_table(name: Colormap, near: Near = Near.WARM) -> npt.NDArray[np.uint8]:
    """The colours of a colormap, (256, 3) RGB uint8, the far one first.

    ``warm`` and ``white`` put the bright or red end near, ``black`` the other.
    """
    levels = np.arange(_LEVELS, dtype=np.uint8)
    colours: npt.NDArray[np.generic]
    if name == Colormap.GRAY:
        colours = np.repeat(levels[:, None], 3, axis=1)
    elif name == Colormap.SPECTRAL:
        stops = np.linspace(0, _LEVELS - 1, len(_SPECTRAL))
        channels = np.array(_SPECTRAL).T
        colours = np.rint(np.stack([np.interp(levels, stops, c) for c in channels], 1))
    else:
        colours = cv2.applyColorMap(levels, _OPENCV[name]).reshape(-1, 3)[:, ::-1]
    table_8bit = np.asarray(colours, np.uint8)
    return table_8bit[::-1] if near == Near.BLACK else table_8bit
