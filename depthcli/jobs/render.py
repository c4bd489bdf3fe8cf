"""A folder of rendered rooms: pictures, depth and cameras, as training reads them."""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from depthcli.core.foreign import FieldError, parsed_json
from depthcli.core.parallel.process_map import process_map
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.paired_folder import CAMERAS
from depthcli.datasets.rooms.pair import VERSION, Recipe, render_pair, room_focal_px
from depthcli.errors import OutputError, UsageError
from depthcli.io.depth.steps import quantized
from depthcli.io.png.encode import encode_png
from depthcli.io.storage.atomic import atomic_path, write_text
from depthcli.io.storage.regular import read_regular
from depthcli.io.writers.formats import MILLIMETRES

RECIPE = "rooms.json"
_OPTIONS = {"seed": "--seed", "size": "--size", "hfov_deg": "--hfov", "sensor": "--sensor"}
_PER_FOLDER = 100
_MAX_RECIPE_BYTES = 2**16


@dataclass(frozen=True, slots=True)
class RenderRequest:
    """What is to be rendered."""

    out: Path  #: receives ``rgb/``, ``depth/``, ``cameras.csv`` and ``rooms.json``
    count: int  #: rooms in all, with those that are there
    recipe: Recipe
    workers: int = 1  #: processes


@dataclass(frozen=True, slots=True)
class Rendered:
    """What is in the folder now."""

    out: Path
    count: int  #: rooms that were asked for, all there
    made: int  #: of them, those rendered by this run


def render(request: RenderRequest, progress: Progress = NO_PROGRESS) -> Rendered:
    """Render the rooms that are not there yet.

    The same numbers and options give the same bytes, whatever the count and the workers were.

    Raises:
        UsageError: the folder holds something else, or rooms of other options.
        OutputError: a file cannot be written.
    """
    _claim(request)
    missing = [
        i for i in range(request.count) if not all(f.exists() for f in _pair_files(request.out, i))
    ]
    done = progress.begin("", len(missing), "rooms")
    write = partial(_write_pair, request.out, request.recipe)
    for _ in process_map(write, missing, workers=min(request.workers, len(missing))):
        done(1)
    return Rendered(request.out, request.count, len(missing))


def _claim(request: RenderRequest) -> None:
    """Make sure that the folder is for this recipe, and name the camera of every room."""
    out, path = request.out, request.out / RECIPE
    wanted = json.dumps({"version": VERSION, **request.recipe._asdict()})
    try:
        held = parsed_json(read_regular(path, _MAX_RECIPE_BYTES))
    except FileNotFoundError:
        if any((out / name).exists() for name in ("rgb", "depth", CAMERAS)):
            raise UsageError(f"{out} holds other pictures; give another --out") from None
    except (OSError, FieldError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"cannot read {path}: {reason}; remove it or give another --out"
        ) from error
    else:
        if json.dumps(held) != wanted:
            raise UsageError(
                f"{out} holds rooms made with {_differing(held, json.loads(wanted))}; give the "
                "same options or another --out"
            )
    write_text(wanted + "\n", path)
    count = max(request.count, _camera_count(out / CAMERAS))
    rows = (f"{_pair_name(i)},{room_focal_px(request.recipe, i):.6f}\n" for i in range(count))
    write_text("id,focal_px\n" + "".join(rows), out / CAMERAS)


def _differing(held: Any, wanted: dict[str, object]) -> str:  # noqa: ANN401 - any JSON
    """What the rooms that are there were made with, as it is typed, where that is not wanted."""
    if not isinstance(held, dict) or held.get("version") != VERSION:
        return "another version of depthcli"
    others = {name: held.get(name) for name, value in wanted.items() if held.get(name) != value}
    return " ".join(f"{_OPTIONS[name]} {_typed(name, value)}" for name, value in others.items())


def _typed(name: str, value: object) -> str:
    """A value as the option takes it: ``256x192``, ``30-110``, ``kinect``."""
    between = "x" if name == "size" else "-"
    parts = value if isinstance(value, list) else [value]
    return between.join(str(part).removesuffix(".0") for part in parts)


def _camera_count(cameras: Path) -> int:
    """How many rooms an earlier run was asked for."""
    return cameras.read_bytes().count(b"\n") - 1 if cameras.is_file() else 0


def _pair_name(index: int) -> str:
    """A folder for every hundred is a scene, so that some can be held out for validation."""
    return f"{index // _PER_FOLDER:04}/{index:06}"


def _pair_files(out: Path, index: int) -> tuple[Path, Path]:
    name = _pair_name(index)
    return out / "rgb" / f"{name}.jpg", out / "depth" / f"{name}.png"


def _write_pair(out: Path, recipe: Recipe, index: int) -> None:
    pair = render_pair(recipe, index)
    picture, depth = _pair_files(out, index)
    encoded = cv2.imencode(".jpg", cv2.cvtColor(pair.rgb, cv2.COLOR_RGB2BGR))[1]
    steps, _ = quantized(pair.depth_m.astype(np.float32), MILLIMETRES)
    for path, data in ((picture, encoded.tobytes()), (depth, encode_png(steps))):
        with atomic_path(path) as temporary:
            temporary.write_bytes(data)
