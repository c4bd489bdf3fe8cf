"""A JSON file with the metadata of the other outputs."""

import json
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.types import DepthMap, DepthRange, Frame, Provenance
from depthcli.io.formats.metadata import SOFTWARE, DepthMetadata, anchor_fields
from depthcli.io.formats.table import MILLIMETRES


@dataclass(frozen=True, slots=True)
class SidecarWriter:
    """Unit, scale, kind, orientation, model, resize, camera, range and version."""

    png_scale: float = MILLIMETRES  #: units per metre of the 16-bit PNG beside it
    png_normalize: bool = False  #: whether that PNG is normalized instead

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one JSON object."""
        known, source = DepthMetadata.of(depth), depth.provenance or Provenance()
        document = {
            "software": SOFTWARE,
            "kind": known.kind,
            "unit": known.unit,
            "png16_scale": None if self.png_normalize or not depth.is_metric else self.png_scale,
            "width": depth.width,
            "height": depth.height,
            "orientation": frame.orientation if frame else source.orientation,
            **({} if source.time_s is None else {"time_s": source.time_s}),
            **DepthRange.of(depth)._asdict(),
            "network_size_px": source.input_size_px,
            **known.origin(),
            **anchor_fields(depth),
        }
        path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", "utf-8")
        return ()
