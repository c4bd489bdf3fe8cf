"""A JSON file that says what the numbers of the other outputs mean."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.io.writers.facts import SOFTWARE, Facts
from depthcli.io.writers.formats import MILLIMETRES


@dataclass(frozen=True, slots=True)
class SidecarWriter:
    """Unit, scale, kind, orientation, model, resize, focal length, range and version."""

    png_scale: float = MILLIMETRES  #: steps per metre of the 16-bit PNG beside it
    png_normalize: bool = False  #: that is normalized instead

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one JSON object."""
        finite = depth.values[np.isfinite(depth.values)]
        has_depth = bool(finite.size)
        known, source = Facts.of(depth), depth.provenance or Provenance()
        facts = {
            "software": SOFTWARE,
            "kind": known.kind,
            "unit": known.unit,
            "png16_scale": None if self.png_normalize or not depth.is_metric else self.png_scale,
            "width": depth.width,
            "height": depth.height,
            "orientation": frame.orientation if frame else source.orientation,
            "min": float(finite.min()) if has_depth else None,
            "median": float(np.median(finite)) if has_depth else None,
            "max": float(finite.max()) if has_depth else None,
            "network_size_px": source.input_size_px,
            **known.origin(),
        }
        path.write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n", "utf-8")
        return ()
