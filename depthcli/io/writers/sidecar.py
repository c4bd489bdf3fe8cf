"""A JSON file that says what the numbers of the other outputs mean."""

import json
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.summary import DepthRange
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
        known, source = Facts.of(depth), depth.provenance or Provenance()
        facts = {
            "software": SOFTWARE,
            "kind": known.kind,
            "unit": known.unit,
            "png16_scale": None if self.png_normalize or not depth.is_metric else self.png_scale,
            "width": depth.width,
            "height": depth.height,
            "orientation": frame.orientation if frame else source.orientation,
            **DepthRange.of(depth)._asdict(),
            "network_size_px": source.input_size_px,
            **known.origin(),
        }
        path.write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n", "utf-8")
        return ()
