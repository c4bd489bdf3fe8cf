"""Cameras whose scale was measured, kept under a name in the user's configuration."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from depthcli.core.camera import CameraScale, Intrinsics
from depthcli.core.validation import parsed_json
from depthcli.errors import UsageError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.paths import config_folder, read_regular

if TYPE_CHECKING:
    from pathlib import Path

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_MAX_BYTES = 2**16


def keep_camera(scale: CameraScale, hfov_deg: float | None) -> Path:
    """Write a camera's scale and field of view; an earlier camera of the name is replaced."""
    path = _path(scale.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    document = {"hfov_deg": hfov_deg, **asdict(scale)}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2) + "\n", "utf-8")
    return path


def kept_camera(name: str) -> Intrinsics:
    """The camera of a name."""
    path = _path(name)
    try:
        document: Any = parsed_json(read_regular(path, _MAX_BYTES))
        hfov_deg = document.pop("hfov_deg")
        return Intrinsics(hfov_deg=hfov_deg, scale=CameraScale(**document))
    except FileNotFoundError as error:
        there = sorted(file.stem for file in path.parent.glob("*.json"))
        known = f"there are {', '.join(there)}" if there else "there is none"
        raise UsageError(
            f"no camera named {name!r}: {known}", "make it with 'depthcli calibrate'"
        ) from error
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise UsageError(f"{path} is no calibrated camera", "calibrate it again") from error


def _path(name: str) -> Path:
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} is not a name of letters, digits, '-', '_' and '.'")
    return config_folder() / "cameras" / f"{name}.json"
