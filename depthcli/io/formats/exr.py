"""OpenEXR: floating-point depth, for compositing."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthMap, Frame, Provenance, Window, over_window
from depthcli.io.depth.metadata import own_texts
from depthcli.io.exr.file import write_exr
from depthcli.io.formats.metadata import metadata_texts


@dataclass(frozen=True, slots=True)
class ExrWriter:
    """One channel, ZIP-compressed."""

    #: ``Y``, which most readers show; ``Z`` (renderers' depth), ``R`` or ``depth.Z``
    exr_channel: str = "Y"
    half: bool = False  #: 16-bit instead of 32-bit floats

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write metres along the camera axis, bit for bit unless ``half``; NaN stays NaN.

        The windows, the rate and the time code are those of the frame.
        """
        shown, stored, windows = _windowed(depth, frame)
        values = np.ascontiguousarray(stored)
        if self.half:
            with np.errstate(over="ignore"):
                values = values.astype(np.float16)
        write_exr(
            path,
            {self.exr_channel: values},
            own_texts(metadata_texts(shown)),
            frame.rate if frame else None,
            pixel_aspect=_pixel_aspect(depth, frame),
            windows=windows,
            time_code=frame.time_code if frame else None,
        )
        lost = np.count_nonzero(np.isinf(values) & np.isfinite(stored)) if self.half else 0
        return (f"{lost} pixels are beyond half floats and became infinite",) if lost else ()


def _pixel_aspect(depth: DepthMap, frame: Frame | None) -> float:
    if depth.provenance is None and frame is not None:
        return frame.pixel_aspect
    return (depth.provenance or Provenance()).pixel_aspect


def _windowed(
    depth: DepthMap, frame: Frame | None
) -> tuple[DepthMap, npt.NDArray[np.float32], tuple[Window, Window] | None]:
    """The map in the display window, which its camera is of; the data, and both windows."""
    windows = frame.windows if frame else None
    if windows is None:
        return depth, depth.values, None
    display = windows.display
    # A file has to have a pixel.
    corner = Window(display.left, display.top, display.left + 1, display.top + 1)
    data = corner if windows.valid.is_empty else windows.valid
    shown, stored = (over_window(depth.values, windows.pixels, one) for one in (display, data))
    return replace(depth, values=shown), stored, (data, display)
