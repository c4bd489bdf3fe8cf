"""Rendering rooms into a training folder: pictures, depth and cameras."""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from depthcli.core.parallel import process_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.folders import CAMERAS_NAME
from depthcli.datasets.rooms.render import VERSION, RoomSettings, render_pair, room_focal_px
from depthcli.errors import OutputError, UsageError, os_errors_as
from depthcli.io.depth.metadata import quantized
from depthcli.io.formats.table import MILLIMETRES
from depthcli.io.images.png import encode_png
from depthcli.io.storage.atomic import atomic_path, write_text

SETTINGS_NAME = "rooms.json"
_PER_FOLDER = 100


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
        i for i in range(request.count) if not all(f.is_file() for f in _pair_files(request.out, i))
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
    if path.exists():
        with os_errors_as(OutputError, f"cannot read {path}", "give another {out}"):
            held = path.read_bytes()
        if held.strip() != text.encode():
            told = f"{out} holds rooms of other options, or of another version"
            raise UsageError(told, f"give those of {path}, or another {{out}}")
    elif any((out / name).exists() for name in ("rgb", "depth", CAMERAS_NAME)):
        raise UsageError(f"{out} holds other images", "give another {out}")
    write_text(text + "\n", path)
    cameras = out / CAMERAS_NAME
    rows = cameras.read_bytes().count(b"\n") - 1 if cameras.is_file() else 0
    focal = ((i, room_focal_px(request.settings, i)) for i in range(max(request.count, rows)))
    lines = (f"{_pair_name(i)},{focal_px:.6f}\n" for i, focal_px in focal)
    write_text("id,focal_px\n" + "".join(lines), cameras)


def _pair_name(index: int) -> str:
    """Path without suffix; every hundred rooms are a scene, for validation on held-out scenes."""
    return f"{index // _PER_FOLDER:04}/{index:06}"


def _pair_files(out: Path, index: int) -> tuple[Path, Path]:
    name = _pair_name(index)
    return out / "rgb" / f"{name}.jpg", out / "depth" / f"{name}.png"


def _write_pair(out: Path, settings: RoomSettings, index: int) -> None:
    pair = render_pair(settings, index)
    picture, depth = _pair_files(out, index)
    encoded = cv2.imencode(".jpg", cv2.cvtColor(pair.rgb, cv2.COLOR_RGB2BGR))[1]
    steps, _ = quantized(pair.depth_m.astype(np.float32), MILLIMETRES)
    for path, data in ((picture, encoded.tobytes()), (depth, encode_png(steps))):
        with atomic_path(path) as temporary:
            temporary.write_bytes(data)
