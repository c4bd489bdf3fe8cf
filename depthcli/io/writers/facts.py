"""What is said of a depth map in files and reports: one name for each fact, everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from depthcli import __version__
from depthcli.core.types import Provenance

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap

_MILLIMETRES = 1000
SOFTWARE = f"depthcli {__version__}"
_UNKNOWN = Provenance()


class Facts(NamedTuple):
    """The facts that hold for a map in any format; the names are those in JSON.

    Attributes:
        kind: metric, relative or inverse.
        unit: ``m``; None for relative and inverse maps.
        model: name of the model; None if unknown.
        model_sha256: checksum of its file; None if unknown.
        focal_px: focal length that metres were scaled by; None if they were not.
    """

    kind: str
    unit: str | None
    model: str | None
    model_sha256: str | None
    focal_px: float | None

    @classmethod
    def of(cls, depth: DepthMap) -> Facts:
        """What is known of a map."""
        source = depth.provenance or _UNKNOWN
        unit = "m" if depth.is_metric else None
        return cls(depth.kind.value, unit, source.model, source.model_sha256, source.focal_px)


def facts(depth: DepthMap) -> dict[str, str]:
    """The facts and the software, in words; what is unknown is left out.

    The unit of a map that has none is ``none``.
    """
    known = Facts.of(depth)
    words = {"kind": known.kind, "unit": known.unit or "none", "software": SOFTWARE}
    source = {"model": known.model, "model_sha256": known.model_sha256}
    words |= {name: text for name, text in source.items() if text}
    return words | ({"focal_px": f"{known.focal_px:.6g}"} if known.focal_px else {})


def step_unit(scale: float) -> str:
    """Unit of whole steps, ``mm`` where a metre has 1000 of them."""
    return "mm" if scale == _MILLIMETRES else f"1/{scale:g} m"
