"""What a depth file says of itself besides its pixels."""

import re
from collections.abc import Mapping
from pathlib import Path

from depthcli.core.foreign import FieldError, parsed_json
from depthcli.core.types import CameraSource, Provenance
from depthcli.io.pictures.decode import read_bytes
from depthcli.io.png.chunks import read_text
from depthcli.io.storage.regular import read_regular
from depthcli.io.writers.facts import ORIGIN_FACTS

_MAX_SIDECAR_BYTES = 2**20
_LEAST, _MOST = 1e-9, 1e12
_PREFIX = "depthcli:"
_FRAME_NUMBER = r"\.\d{6,}$"
_ORIENTATIONS = frozenset("12345678")
_SHARED = ("software", "orientation", *ORIGIN_FACTS)


def stated_facts(path: Path) -> dict[str, str]:
    """Unit, scale, kind, orientation, model and so on, as the file's writer stated them, by name.

    What a PNG or EXR does not say comes from the sidecar beside it, if that names no other model.
    Empty if another program wrote the file.

    Raises:
        InputError: missing or damaged.
    """
    suffix = path.suffix.lower()
    if suffix == ".png":
        return completed(path, read_text(read_bytes(path)))
    if suffix == ".exr":
        # Reading PNG need not wait for OpenEXR.
        from depthcli.io.depth.exr import read_exr_texts  # noqa: PLC0415

        return completed(path, read_exr_texts(path))
    return completed(path, {})


def completed(path: Path, texts: Mapping[str, str]) -> dict[str, str]:
    """The facts among a file's own texts, and what its sidecar adds to them."""
    own = {k.removeprefix(_PREFIX): v for k, v in texts.items() if k.startswith(_PREFIX)}
    return own | {k: v for k, v in _beside(path, own).items() if k not in own}


def provenance_of(facts: Mapping[str, str]) -> Provenance | None:
    """Where a map came from, as far as its facts say; None if they say nothing of it."""
    orientation, source = facts.get("orientation"), facts.get("camera_source")
    found = Provenance(
        model=facts.get("model"),
        model_sha256=facts.get("model_sha256"),
        focal_px=positive_number(facts.get("focal_px")),
        orientation=int(orientation) if orientation in _ORIENTATIONS else None,
        camera_source=CameraSource(source) if source in tuple(CameraSource) else None,
    )
    return None if found == Provenance() else found


def positive_number(text: str | None) -> float | None:
    """A number above 0 that another program may have written; None for anything else.

    Numbers at the ends of a float count as nothing: depths divided by them would be none.
    """
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if _LEAST < value < _MOST else None


def sidecar_facts(path: Path) -> dict[str, object]:
    """What our own sidecar beside a file says, or that of the video it is a frame of."""
    own = path.with_suffix(".json")
    return _facts_in(own) or _facts_in(own.with_stem(re.sub(_FRAME_NUMBER, "", own.stem)))


def _facts_in(path: Path) -> dict[str, object]:
    """Our own sidecar; empty if there is none."""
    try:
        facts = parsed_json(read_regular(path, _MAX_SIDECAR_BYTES))
    except (OSError, FieldError):
        return {}
    if not (isinstance(facts, dict) and str(facts.get("software")).startswith("depthcli ")):
        return {}
    if "sha256" in facts:  # as version 0.1 called it in the sidecar of a video
        facts.setdefault("model_sha256", facts.pop("sha256"))
    return facts


def _beside(path: Path, own: Mapping[str, str]) -> dict[str, str]:
    facts = sidecar_facts(path)
    model = facts.get("model_sha256")
    if own.get("model_sha256", model) != model:
        return {}
    return {name: str(facts[name]) for name in _SHARED if facts.get(name) is not None}
