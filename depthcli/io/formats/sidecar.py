"""A JSON file with the metadata of the other outputs."""

import json
from pathlib import Path

from depthcli.core.types import DepthMap, DepthRange, Frame
from depthcli.io.formats.options import WriterOptions
from depthcli.io.stored import metadata
from depthcli.io.stored.sidecar import SIDECAR_ENDS


class SidecarWriter(WriterOptions):
    """Unit, scale, kind, orientation, model, resize, camera, range and version."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one JSON object."""
        source = depth.provenance
        range_, ends = DepthRange.of(depth), dict[str, float]()
        if self.is_normalized and range_.min is not None and range_.max is not None:
            ends = dict(zip(SIDECAR_ENDS, self.range_of((range_.min, range_.max)), strict=True))
        has_unit = depth.is_metric and not self.is_normalized
        document = {
            "software": metadata.SOFTWARE,
            "kind": depth.kind.value,
            "unit": depth.unit,
            "png16_scale": self.units_per_metre if has_unit else None,
            **({"png16_inverse": True} if self.png_inverse and depth.is_metric else {}),
            **ends,
            "width": depth.width,
            "height": depth.height,
            "orientation": frame.orientation if frame else source.orientation,
            **({"projection": source.projection} if source.projection.is_other else {}),
            **({} if source.time_s is None else {"time_s": source.time_s}),
            **range_._asdict(),
            "network_size_px": source.input_size_px,
            **metadata.origin_fields(depth),
            **metadata.known_depth_fields(depth),
        }
        path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", "utf-8")
        return ()
