"""OpenEXR: floating-point depth, for compositing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from depthcli.core.point_cloud import with_centre
from depthcli.core.types import DepthMap, Frame
from depthcli.io.depth.exr import write_exr
from depthcli.io.writers.metadata import metadata_texts


@dataclass(frozen=True, slots=True)
class ExrWriter:
    """One channel, ZIP-compressed."""

    #: ``Y``, which most readers show; ``Z`` (renderers' depth), ``R`` or ``depth.Z``
    exr_channel: str = "Y"
    half: bool = False  #: 16-bit instead of 32-bit floats
    #: (cx, cy), principal point in pixels of the map; None for what the map states
    centre_px: tuple[float, float] | None = None

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write metres along the camera axis, bit for bit unless ``half``; NaN stays NaN."""
        rate = frame.rate if frame else None
        values = np.ascontiguousarray(depth.values)
        metadata = metadata_texts(with_centre(depth, self.centre_px))
        texts = {f"depthcli:{name}": text for name, text in metadata.items()}
        if not self.half:
            write_exr(path, {self.exr_channel: values}, texts, rate)
            return ()
        with np.errstate(over="ignore"):
            halves = values.astype(np.float16)
        write_exr(path, {self.exr_channel: halves}, texts, rate)
        lost = np.count_nonzero(np.isinf(halves) & np.isfinite(values))
        return (f"{lost} pixels are beyond half floats and became infinite",) if lost else ()
