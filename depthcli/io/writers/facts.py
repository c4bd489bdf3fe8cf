"""What is said of a depth map in files and reports: one name for each fact, everywhere."""

from typing import NamedTuple, Self

from depthcli._version import __version__
from depthcli.core import scaling
from depthcli.core.types import CameraSource, DepthMap, Provenance
from depthcli.io.writers.formats import MILLIMETRES

SOFTWARE = f"depthcli {__version__}"
_UNKNOWN = Provenance()
_HOW_KNOWN = {
    CameraSource.OPTION: "given",
    CameraSource.EXIF: "from EXIF",
    CameraSource.CARD: "assumed, from the model's card",
}


class Facts(NamedTuple):
    """The facts that hold for a map in any format; the names are those in JSON."""

    kind: str  #: metric, relative or inverse
    unit: str | None  #: ``m``; None for relative and inverse maps
    model: str | None  #: name of the model; None if unknown
    model_sha256: str | None  #: checksum of its file; None if unknown
    #: focal length that the metres belong to, in pixels of the map; None if unknown
    focal_px: float | None
    #: ``option``, ``exif``, or ``card`` if it is assumed; None if unknown
    camera_source: str | None
    camera: str | None  #: both of them for people; None if unknown

    @classmethod
    def of(cls, depth: DepthMap) -> Self:
        """What is known of a map."""
        source = depth.provenance or _UNKNOWN
        return cls(
            kind=depth.kind.value,
            unit="m" if depth.is_metric else None,
            model=source.model,
            model_sha256=source.model_sha256,
            focal_px=source.focal_px,
            camera_source=source.camera_source,
            camera=camera_words(depth),
        )

    def origin(self) -> dict[str, str | float | None]:
        """The facts of model and camera, under their names: ``ORIGIN_FACTS``."""
        return {name: getattr(self, name) for name in ORIGIN_FACTS}


ORIGIN_FACTS = tuple(name for name in Facts._fields if name not in {"kind", "unit"})
"""Names of what is known of a map's origin; a file that cannot state it has a sidecar that does."""


def facts(depth: DepthMap) -> dict[str, str]:
    """The facts and the software, in words; what is unknown is left out.

    The unit of a map that has none is ``none``.
    """
    known = Facts.of(depth)
    words = {"kind": known.kind, "unit": known.unit or "none", "software": SOFTWARE}
    return words | {name: _word(fact) for name, fact in known.origin().items() if fact}


def _word(fact: str | float | None) -> str:
    return f"{fact:.6g}" if isinstance(fact, float) else str(fact)


def camera_words(depth: DepthMap) -> str | None:
    """The camera of a map's metres, how it is known, and what anchors changed; None if unknown."""
    source = depth.provenance or _UNKNOWN
    count = len(source.anchors)
    fitted = f"; depth fitted to {count} anchor{'s'[: count - 1]}" if count else ""
    if source.focal_px is None:
        return f"unknown{fitted}" if fitted else None
    hfov = f"hfov {scaling.hfov_deg(source.focal_px, depth.width):.1f}°"
    known = "" if source.camera_source is None else f" ({_HOW_KNOWN[source.camera_source]})"
    return f"{hfov}{known}{fitted}"


def step_unit(scale: float) -> str:
    """Unit of whole steps, ``mm`` where a metre has 1000 of them."""
    return "mm" if scale == MILLIMETRES else f"1/{scale:g} m"
