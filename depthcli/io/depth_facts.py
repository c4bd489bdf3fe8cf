"""What a depth file says of itself besides its pixels."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING

from depthcli.io.decode import read_bytes
from depthcli.io.png_text import read_text

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

_PREFIX = "depthcli:"
_FRAME_NUMBER = re.compile(r"\.\d{6,}$")
_SHARED = ("software", "orientation", "model", "model_sha256", "focal_px")


def stated_facts(path: Path) -> dict[str, str]:
    """Unit, scale, kind, orientation, model and so on, as the file's writer stated them.

    What the file does not say comes from the sidecar beside it, if that names no other model.

    Args:
        path: a PNG or EXR; other files state nothing themselves.

    Returns:
        Name -> text; empty if another program wrote the file.

    Raises:
        InputError: missing or damaged.
    """
    suffix = path.suffix.lower()
    if suffix == ".png":
        texts = read_text(read_bytes(path))
    elif suffix == ".exr":
        # Reading PNG need not wait for OpenEXR.
        from depthcli.io.exr_files import read_exr_texts  # noqa: PLC0415

        texts = read_exr_texts(path)
    else:
        texts = {}
    own = {k.removeprefix(_PREFIX): v for k, v in texts.items() if k.startswith(_PREFIX)}
    return own | {k: v for k, v in _beside(path, own).items() if k not in own}


def sidecar_facts(path: Path) -> dict[str, object]:
    """What our own sidecar beside a file says, or that of the video it is a frame of."""
    own = path.with_suffix(".json")
    return _facts_in(own) or _facts_in(own.with_stem(_FRAME_NUMBER.sub("", own.stem)))


def _facts_in(path: Path) -> dict[str, object]:
    """Our own sidecar; empty if there is none."""
    try:
        facts = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    ours = isinstance(facts, dict) and str(facts.get("software")).startswith("depthcli ")
    return facts if ours else {}


def _beside(path: Path, own: Mapping[str, str]) -> dict[str, str]:
    facts = sidecar_facts(path)
    model = facts.get("model_sha256")
    if own.get("model_sha256", model) != model:
        return {}
    return {name: str(facts[name]) for name in _SHARED if facts.get(name) is not None}
