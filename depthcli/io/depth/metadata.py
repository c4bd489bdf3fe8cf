"""Reading the metadata of a depth file."""

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from depthcli.core.types import CameraSource, DepthKind, Provenance
from depthcli.core.validation import FieldError, parsed_json
from depthcli.io.pictures.decode import read_bytes
from depthcli.io.png.chunks import read_text
from depthcli.io.storage.regular import read_regular
from depthcli.io.writers.metadata import ORIGIN_FIELDS

_MAX_SIDECAR_BYTES = 2**26  # with a line for each frame of a long video
_LEAST, _MOST = 1e-9, 1e12
_PREFIX = "depthcli:"
_FRAME_NAME = re.compile(r"(.*?)([._\- ]*)(\d+)(\D*)", re.ASCII | re.DOTALL)
_MIN_DIGITS = 6  # of the names that depthcli chooses
_ORIENTATIONS = frozenset("12345678")
_SHARED = ("software", "orientation", "time_s", *ORIGIN_FIELDS)


def read_metadata(path: Path) -> dict[str, str]:
    """Unit, scale, kind, orientation, model and so on, by name.

    What a PNG or EXR does not state comes from the sidecar beside it, unless that names another
    model. Empty if another program wrote the file.

    Raises:
        InputError: missing or damaged.
    """
    suffix = path.suffix.lower()
    if suffix == ".png":
        return with_sidecar(path, read_text(read_bytes(path)))
    if suffix == ".exr":
        # Reading PNG need not wait for OpenEXR.
        from depthcli.io.depth.exr import read_exr_texts  # noqa: PLC0415

        return with_sidecar(path, read_exr_texts(path))
    return with_sidecar(path, {})


def with_sidecar(path: Path, texts: Mapping[str, str]) -> dict[str, str]:
    """The metadata among a file's own texts, completed from its sidecar."""
    own = {k.removeprefix(_PREFIX): v for k, v in texts.items() if k.startswith(_PREFIX)}
    return own | {k: v for k, v in _sidecar_texts(path, own).items() if k not in own}


def provenance_of(metadata: Mapping[str, str]) -> Provenance | None:
    """The provenance of a map, as far as its metadata state it; None if they state nothing."""
    orientation, source = metadata.get("orientation"), metadata.get("camera_source")
    found = Provenance(
        model=metadata.get("model"),
        model_sha256=metadata.get("model_sha256"),
        focal_px=positive_number(metadata.get("focal_px")),
        orientation=int(orientation) if orientation in _ORIENTATIONS else None,
        camera_source=CameraSource(source) if source in tuple(CameraSource) else None,
        centre_px=_centre_px(metadata.get("centre_px")),
        time_s=number(metadata.get("time_s")),
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


def _centre_px(text: str | None) -> tuple[float, float] | None:
    """A principal point from an untrusted file; None for anything else."""
    match [number(part) for part in (text or "").split(",")]:
        case [float(x), float(y)]:
            return x, y
    return None


def number(text: str | None) -> float | None:
    """A finite number from an untrusted file; None for anything else, also for large ones."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if abs(value) < _MOST else None


def sidecar_metadata(path: Path) -> dict[str, object]:
    """Content of depthcli's sidecar of a file, or of the video that the file is a frame of.

    The latter has the time of that frame as ``time_s``.
    """
    own = path.with_suffix(".json")
    return _read_sidecar(own) or _frame_metadata(own)


def _frame_metadata(own: Path) -> dict[str, object]:
    """What the sidecar of a video states for one of its frames; empty if there is none."""
    name = _FRAME_NAME.fullmatch(own.stem)
    if name is None:
        return {}
    base, separator, digits, end = name.groups()
    metadata = _read_sidecar(own.with_stem(base or "sequence"))
    times_s = metadata.pop("times_s", None)
    if not isinstance(times_s, dict):  # of version 0.6 and before
        is_default = separator == "." and len(digits) >= _MIN_DIGITS and not end
        return metadata if is_default else {}
    time_s = times_s.get(str(int(digits)))
    return {} if time_s is None else metadata | {"time_s": time_s}


def _read_sidecar(path: Path) -> dict[str, object]:
    """The content of a sidecar of depthcli; empty if there is none."""
    try:
        metadata = _parsed(read_regular(path, _MAX_SIDECAR_BYTES))
    except (OSError, FieldError):
        return {}
    if not (isinstance(metadata, dict) and str(metadata.get("software")).startswith("depthcli ")):
        return {}
    metadata = dict(metadata)
    if "sha256" in metadata:  # as version 0.1 called it in the sidecar of a video
        metadata.setdefault("model_sha256", metadata.pop("sha256"))
    return metadata


@lru_cache(maxsize=1)
def _parsed(sidecar: bytes) -> object:
    """The value of a sidecar, which all frames of a long video share; not to be changed."""
    return parsed_json(sidecar)


def _sidecar_texts(path: Path, own: Mapping[str, str]) -> dict[str, str]:
    metadata = sidecar_metadata(path)
    model = metadata.get("model_sha256")
    if own.get("model_sha256", model) != model:
        return {}
    if "software" in own:  # without a principal point, the file has that of its middle
        metadata.pop("centre_px", None)
    return {name: _text(metadata[name]) for name in _SHARED if metadata.get(name) is not None}


def _text(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
