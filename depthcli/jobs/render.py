"""Rendering rooms into a training folder: pictures, depth and cameras."""

import json
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


def render(
    out: Path,
    count: int,
    settings: RoomSettings,
    workers: int = 1,
    progress: Progress = NO_PROGRESS,
) -> int:
    """Render the missing ones of ``count`` rooms by processes, and return how many there were.

    The folder receives ``rgb/``, ``depth/``, ``cameras.csv`` and ``rooms.json``. The same settings
    give the same bytes, independent of count and workers. UsageError if the folder holds other
    images, or rooms made with other settings.
    """
    _check_folder(out, settings)
    _write_cameras(out, count, settings)
    missing = [i for i in range(count) if not all(f.is_file() for f in _pair_files(out, i))]
    done = progress.begin("", len(missing), "rooms")
    write = partial(_write_pair, out, settings)
    for _ in process_map(write, missing, workers=min(workers, len(missing))):
        done(1)
    return len(missing)


def _check_folder(out: Path, settings: RoomSettings) -> None:
    """Check that the folder is for these settings, and write them."""
    path, text = out / SETTINGS_NAME, json.dumps({"version": VERSION, **settings._asdict()})
    if path.exists():
        with os_errors_as(OutputError, f"cannot read {path}", "give another {out}"):
            held = path.read_bytes()
        if held.strip() != text.encode():
            told = f"{out} holds rooms of other options, or of another version"
            raise UsageError(told, f"give those of {path}, or another {{out}}")
    elif any((out / name).exists() for name in ("rgb", "depth", CAMERAS_NAME)):
        raise UsageError(f"{out} holds other images", "give another {out}")
    write_text(text + "\n", path)


def _write_cameras(out: Path, count: int, settings: RoomSettings) -> None:
    cameras = out / CAMERAS_NAME
    rows = cameras.read_bytes().count(b"\n") - 1 if cameras.is_file() else 0
    focal = ((i, room_focal_px(settings, i)) for i in range(max(count, rows)))
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
