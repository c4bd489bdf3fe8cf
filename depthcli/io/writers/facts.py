"""What is written into files about a depth map, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli import __version__

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap

SOFTWARE = f"depthcli {__version__}"


def facts(depth: DepthMap) -> dict[str, str]:
    """Kind, unit, software and, where known, model of a map; decoding never depends on them."""
    texts = {"kind": depth.kind.value, "unit": unit(depth), "software": SOFTWARE}
    if depth.provenance:
        if depth.provenance.model:
            texts["model"] = depth.provenance.model
        if depth.provenance.model_sha256:
            texts["model_sha256"] = depth.provenance.model_sha256
        if depth.provenance.focal_px:
            texts["focal_px"] = f"{depth.provenance.focal_px:.6g}"
    return texts


def unit(depth: DepthMap) -> str:
    """``m``, or ``none`` for relative and inverse maps."""
    return "m" if depth.is_metric else "none"
