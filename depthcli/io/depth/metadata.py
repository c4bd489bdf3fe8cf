"""The values of a depth file's metadata, which are texts by name."""

from collections.abc import Mapping

from depthcli.core.camera import CameraSource
from depthcli.core.types import PIXEL_ASPECTS, AnchorFit, DepthKind, Provenance
from depthcli.io.formats.table import KEY_PREFIX

_LEAST, _MOST = 1e-9, 1e12
_ORIENTATIONS = frozenset("12345678")


def own_metadata(texts: Mapping[str, str]) -> dict[str, str]:
    """The metadata among the texts of a PNG or EXR, by name; empty if another program wrote it."""
    return {k.removeprefix(KEY_PREFIX): v for k, v in texts.items() if k.startswith(KEY_PREFIX)}


def own_texts(metadata: Mapping[str, str]) -> dict[str, str]:
    """The texts of a PNG or EXR that state metadata; :func:`own_metadata` reads them."""
    return {f"{KEY_PREFIX}{name}": text for name, text in metadata.items()}


def provenance_of(metadata: Mapping[str, str]) -> Provenance | None:
    """The provenance of a map, as far as its metadata state it; None if they state nothing."""
    orientation, source = metadata.get("orientation"), metadata.get("camera_source")
    found = Provenance(
        model=metadata.get("model"),
        model_sha256=metadata.get("model_sha256"),
        input_size_px=_size_px(metadata.get("network_size_px")),
        focal_px=positive_number(metadata.get("focal_px")),
        orientation=int(orientation) if orientation in _ORIENTATIONS else None,
        camera_source=CameraSource(source) if source in tuple(CameraSource) else None,
        centre_px=_centre_px(metadata.get("centre_px")),
        time_s=number(metadata.get("time_s")),
        anchor_fit=_anchor_fit(metadata.get("anchors")),
        pixel_aspect=pixel_aspect_in(metadata.get("pixel_aspect")),
    )
    return None if found == Provenance() else found


def kind_named(text: str | None) -> DepthKind:
    """The kind that a file states; metric if it states none."""
    return DepthKind(text) if text in set(DepthKind) else DepthKind.METRIC


def positive_number(text: str | None) -> float | None:
    """A number above 0 from an untrusted file; None for anything else.

    Extremely small and large numbers are refused: depths divided by them would not be finite.
    """
    value = number(text)
    return value if value is not None and value > _LEAST else None


def pixel_aspect_in(text: str | None) -> float:
    """Width by height of a pixel from an untrusted file; 1 for anything else."""
    value = number(text)
    low, high = PIXEL_ASPECTS
    return value if value is not None and low <= value <= high else 1.0


def number(text: str | None) -> float | None:
    """A finite number from an untrusted file; None for anything else, also for large ones."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if abs(value) < _MOST else None


def _number_list(text: str | None) -> list[float | None]:
    return [number(part) for part in (text or "").split(",")]


def _centre_px(text: str | None) -> tuple[float, float] | None:
    """A principal point from an untrusted file; None for anything else."""
    match _number_list(text):
        case [float(x), float(y)]:
            return x, y
    return None


def _size_px(text: str | None) -> tuple[int, int] | None:
    """A size in whole pixels from an untrusted file; None for anything else."""
    match _number_list(text):
        case [float(width), float(height)] if width >= 1 and height >= 1:
            return int(width), int(height)
    return None


def _anchor_fit(text: str | None) -> AnchorFit | None:
    """A fit to known points from an untrusted file; None for anything else."""
    match _number_list(text):
        case [float(used), float(given), float(residual_m)] if (
            1 <= used <= given and residual_m >= 0
        ):
            return AnchorFit(int(used), int(given), residual_m)
    return None
