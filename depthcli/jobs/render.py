"""Rendering rooms into a training folder: pictures, depth and cameras."""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from depthcli.core.parallel import process_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.validation import FieldError, parsed_json
from depthcli.datasets.folders import CAMERAS_NAME
from depthcli.datasets.rooms.render import VERSION, RoomSettings, render_pair, room_focal_px
from depthcli.errors import OutputError, UsageError
from depthcli.io.depth.metadata import quantized
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.images.png import encode_png
from depthcli.io.storage.atomic import atomic_path, write_text
from depthcli.io.storage.paths import read_regular

SETTINGS_NAME = "rooms.json"
_PER_FOLDER = 100
_ENDS = {".jpg": b"\xff\xd9", ".png": b"IEND\xaeB`\x82"}
_MAX_SETTINGS_BYTES = 2**16


@dataclass(frozen=True, slots=True)
class RenderRequest:
    """Which rooms to render."""

    out: Path  #: receives ``rgb/``, ``depth/``, ``cameras.csv`` and ``rooms.json``
    count: int  #: total number of rooms, including existing ones
    settings: RoomSettings
    workers: int = 1  #: processes


def render(request: RenderRequest, progress: Progress = NO_PROGRESS) -> int:
    """Render the missing rooms, and return how many there were.

    The same options give the same bytes, independent of count and workers. UsageError if the folder
    holds other images, or rooms made with other options.
    """
    _check_folder(request)
    missing = [
        i for i in range(request.count) if not all(map(_is_complete, _pair_files(request.out, i)))
    ]
    done = progress.begin("", len(missing), "rooms")
    write = partial(_write_pair, request.out, request.settings)
    for _ in process_map(write, missing, workers=min(request.workers, len(missing))):
        done(1)
    return len(missing)


def _check_folder(request: RenderRequest) -> None:
    """Check that the folder is for these settings, and write the settings and the cameras."""
    out, path = request.out, request.out / SETTINGS_NAME
    text = json.dumps({"version": VERSION, **request.settings._asdict()})
    try:
        held, wanted = parsed_json(read_regular(path, _MAX_SETTINGS_BYTES)), json.loads(text)
    except FileNotFoundError:
        if any((out / name).exists() for name in ("rgb", "depth", CAMERAS_NAME)):
            raise UsageError(f"{out} holds other images", "give another {out}") from None
    except (OSError, FieldError) as error:
        reason = getattr(error, "strerror", None) or error
        advice = "remove it, or give another {out}"
        raise OutputError(f"cannot read {path}: {reason}", advice) from error
    else:
        if held != wanted:
            raise UsageError(f"{out} holds other rooms", _same_options(held, wanted))
    write_text(text + "\n", path)
    cameras = out / CAMERAS_NAME
    rows = cameras.read_bytes().count(b"\n") - 1 if cameras.is_file() else 0
    focal = ((i, room_focal_px(request.settings, i)) for i in range(max(request.count, rows)))
    lines = (f"{_pair_name(i)},{focal_px:.6f}\n" for i, focal_px in focal)
    write_text("id,focal_px\n" + "".join(lines), cameras)


def _same_options(held: Any, wanted: dict[str, object]) -> str:  # noqa: ANN401 - any JSON
    """Advice with the options of the existing rooms that differ from the requested ones."""
    if not isinstance(held, dict) or held.get("version") != VERSION:
        return "they are of another version of depthcli: give another {out}"
    options = []
    for name, value in wanted.items():
        if (other := held.get(name)) != value:  # as on the command line: 256x192, 30-110, kinect
            parts = other if isinstance(other, list) else [other]
            text = ("x" if name == "size" else "-").join(f"{x}".removesuffix(".0") for x in parts)
            options.append(f"{{{name.removesuffix('_deg')}}} {text}")
    return f"give {' '.join(options)}, or another {{out}}"


def _pair_name(index: int) -> str:
    """Path without suffix; every hundred rooms are a scene, for validation on held-out scenes."""
    return f"{index // _PER_FOLDER:04}/{index:06}"


def _pair_files(out: Path, index: int) -> tuple[Path, Path]:
    name = _pair_name(index)
    return out / "rgb" / f"{name}.jpg", out / "depth" / f"{name}.png"


def _is_complete(path: Path) -> bool:
    """Whether a file is there, and not cut, as by a copy that was interrupted."""
    return path.is_file() and path.read_bytes().endswith(_ENDS[path.suffix])


def _write_pair(out: Path, settings: RoomSettings, index: int) -> None:
    pair = render_pair(settings, index)
    picture, depth = _pair_files(out, index)
    encoded = cv2.imencode(".jpg", cv2.cvtColor(pair.rgb, cv2.COLOR_RGB2BGR))[1]
    steps, _ = quantized(pair.depth_m.astype(np.float32), MILLIMETRES)
    for path, data in ((picture, encoded.tobytes()), (depth, encode_png(steps))):
        with atomic_path(path) as temporary:
            temporary.write_bytes(data)
