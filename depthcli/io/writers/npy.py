"""NumPy's own format: float32, bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from depthcli.core.types import DepthMap, Frame


@dataclass(frozen=True, slots=True)
class NpyWriter:
    """(H, W) float32; metres for metric maps."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the values as they are; the format has no place for their kind."""
        del frame
        with path.open("wb") as file:
            np.save(file, np.ascontiguousarray(depth.values), allow_pickle=False)
        if depth.is_metric:
            return ()
        return (
            f"{depth.kind} depth has no unit, which npy cannot say; a --sidecar beside it does",
        )
