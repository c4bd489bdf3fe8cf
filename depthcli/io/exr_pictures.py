"""Pictures in OpenEXR files, converted from linear light to sRGB."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.choices import MAX_PIXELS
from depthcli.core.picture_limit import PictureLimit
from depthcli.core.text import one_line
from depthcli.core.types import Frame
from depthcli.core.windows import Window, Windows
from depthcli.errors import InputError
from depthcli.io.pictures.decode import check_size

_LINEAR_UP_TO = 0.0031308


def read_exr_picture(
    path: Path,
    *,
    max_pixels: int | PictureLimit = MAX_PIXELS,
    overscan: Window | None = None,
) -> Frame:
    """The colours of an EXR, encoded for display, with its windows and the shape of its pixels.

    Args:
        path: the file; its R, G and B, or those of its first layer that has them, or its Y.
        max_pixels: pictures with more are refused.
        overscan: the window to read, relative to the corner of the display window; None for the
            display window and all that the data window has around it.

    Returns:
        (H, W, 3) RGB or (H, W) gray, float32 in [0, 1]: linear light in the sRGB curve, clipped; 0
        where there is no data.

    Raises:
        InputError: missing, damaged, without colours, or too large.
    """
    # OpenEXR is slow to load.
    from depthcli.io.depth.exr_channels import read_exr_channels  # noqa: PLC0415

    channels = read_exr_channels(path)
    names = _colour_names(path, list(channels))
    first = channels[names[0]]
    display = first.display
    whole = display.union(first.data)
    if overscan is not None:
        whole = overscan.moved(display.left, display.top)
    check_size(str(path), whole.width, whole.height, max_pixels)
    planes = [channels[name].over(whole) for name in names]
    return Frame(
        _srgb(np.dstack(planes) if len(planes) > 1 else planes[0]),
        path,
        pixel_aspect=first.pixel_aspect,
        windows=Windows(whole, first.data, display),
    )


def _colour_names(path: Path, names: Sequence[str]) -> tuple[str, ...]:
    """The names of the channels R, G and B, or of the channel Y."""
    layers = sorted({name[:-1] for name in names if name.endswith("R")}, key=len)
    for layer in layers:
        if {f"{layer}G", f"{layer}B"} <= set(names):
            return tuple(layer + colour for colour in "RGB")
    if "Y" not in names:
        raise InputError(
            f"{path} has no channels R, G, B or Y; it has {one_line(', '.join(names))}"
        )
    return ("Y",)


def read_exr_rate(path: Path) -> Fraction | None:
    """Frames a second that an EXR's header states; None for other files, or if it does not."""
    stated = _header_value(path, "framesPerSecond")
    if not isinstance(stated, Fraction):  # releases of OpenEXR differ
        d = getattr(stated, "d", None)
        stated = Fraction(stated.n, d) if d else None
    return stated if stated and stated > 0 else None


def _header_value(path: Path, name: str) -> Any:  # noqa: ANN401 - of any type that EXR has
    """An attribute of an EXR; None for other files, or if it is not stated."""
    if path.suffix.lower() != ".exr":
        return None
    from depthcli.io.depth.exr import read_exr_header  # noqa: PLC0415 - OpenEXR is slow to load

    return read_exr_header(path).get(name)


def _srgb(linear: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Linear light encoded by the sRGB transfer function (IEC 61966-2-1)."""
    light = np.clip(np.nan_to_num(linear), 0, 1)
    curve = np.float32(1.055) * light ** np.float32(1 / 2.4) - np.float32(0.055)
    shown: npt.NDArray[np.float32] = np.where(
        light <= _LINEAR_UP_TO, light * np.float32(12.92), curve
    )
    return shown
