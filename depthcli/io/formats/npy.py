"""NumPy's own format: float32, bit for bit."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from depthcli.core.types import DepthMap, Frame


@dataclass(frozen=True, slots=True)
class NpyWriter:
    """(H, W) float32; metres for metric maps."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the values unchanged; the format cannot store their kind."""
        del frame
        values = np.ascontiguousarray(depth.values)
        header = np.lib.format.header_data_from_array_1_0(values)
        with path.open("wb") as file:
            np.lib.format.write_array_header_1_0(file, header)
            file.write(values.data)  # np.save reports no error when the disk is full
        if depth.is_metric:
            return ()
        return (
            f"{depth.kind} depth has no unit, which npy cannot say; a --sidecar beside it does",
        )
