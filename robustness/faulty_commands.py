"""Commands that write files, with their inputs, and what must be there when they are done."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from helpers.tiny import synthetic_image, tiny_onnx, write_image, write_model
from helpers.videos import flat_frames, write_video

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SMALL_RUN = """
validate_every = 1
save_every = 1
[generator]
width = 8
blocks = 1
[data]
width = 32
height = 32
holdout_every = 4
holdout_offset = 1
[optim]
epochs_constant = 1
epochs_decay = 2
width_discriminator = 4
pool_size = 2
"""
ENVIRONMENT = {
    "DEPTHCLI_MODELS": "{}/models",
    "XDG_DATA_HOME": "{}/home",
    "XDG_CONFIG_HOME": "{}/home",
    "TMPDIR": "{}",
    "OMP_NUM_THREADS": "1",
}


class Command(NamedTuple):
    """A command in a folder of its own."""

    words: tuple[str, ...]
    prepare: Callable[[Path], None]  #: makes its inputs, and outputs of an earlier run if any
    loads: tuple[str, ...]  #: modules that each run would load anew
    outputs: str = "out"


def _model(folder: Path) -> None:
    write_model(folder / "models" / "default")


def _image(folder: Path) -> None:
    _model(folder)
    write_image(folder / "a.png", synthetic_image(24, 32))


def _image_again(folder: Path) -> None:
    """With outputs of the same names that are whole."""
    _image(folder)
    for end in ("depth.png", "preview.png", "depth.exr", "depth.npy", "ply", "depth.json"):
        path = folder / "out" / f"a.{end}"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"an earlier output\n")


def _images(folder: Path) -> None:
    _model(folder)
    for number, name in enumerate(("a.png", "hall/b.png")):
        write_image(folder / "in" / name, synthetic_image(24, 32 + number))
    write_video(folder / "in" / "c.avi", flat_frames((0, 90), 24, 32))


def _video(folder: Path) -> None:
    _model(folder)
    write_video(folder / "a.avi", flat_frames((0, 90, 180), 24, 32))


def training(folder: Path) -> None:
    """Pairs to train on, and the configuration of a run of seconds."""
    from helpers.rooms import write_rooms  # noqa: PLC0415 - it loads torch

    write_rooms(folder / "data")
    (folder / "small.toml").write_text(SMALL_RUN)


def _checkpoint(folder: Path) -> None:
    from helpers.small import write_checkpoint  # noqa: PLC0415 - it loads torch

    write_checkpoint(folder / "run.ckpt")


def _new_model(folder: Path) -> None:
    _model(folder)
    write_model(folder / "new")


def _known_model(folder: Path) -> None:
    """One of the same name is there already."""
    _new_model(folder)
    write_model(folder / "models" / "tiny", tiny_onnx(stride=2), summary="Another one.")


def _array(folder: Path) -> None:
    np.save(folder / "a.npy", np.full((24, 32), 2.5, np.float32))


_SECONDS = re.compile(rb'"seconds": ?[0-9.e-]+')
_ALL = ("png16", "preview", "exr", "npy", "ply")
_FORMATS = tuple(word for name in _ALL for word in ("--format", name))
_PREDICT = ("predict", "a.png", "-o", "out/", *_FORMATS, "--sidecar", "--threads", "1")
_VIDEO_FORMATS = tuple(word for name in ("mkv", "mp4", "exr") for word in ("--format", name))
_SMALL = ("--workers", "1", "--threads", "1")
TRAIN = (
    *("train", "proposed", "--data", "data", "--out", "out", "--config", "small.toml"),
    *("--threads", "1", "--accelerator", "cpu"),
)
_ADD = ("models", "add", "new/model.onnx", "--card", "new/card.json")
_OF_JOBS = ("depthcli.jobs.image", "depthcli.api.model")
_IMAGES = ("cv2", "onnxruntime", "OpenEXR", *_OF_JOBS)
_VIDEOS = (*_IMAGES, "av", "depthcli.jobs.batch.run", "depthcli.jobs.batch.workers")
_MODELS = (*_IMAGES, "depthcli.jobs.models")
_TORCH = (*_IMAGES, "torch", "lightning_fabric", "depthcli.lab.jobs.train")
_ONNX = (*_TORCH, "onnx", "onnxscript", "depthcli.lab.export.onnx")
COMMANDS = {
    "predict": Command(_PREDICT, _image, _IMAGES),
    "predict again": Command((*_PREDICT, "--overwrite"), _image_again, _IMAGES),
    "batch": Command(
        ("batch", "in", "--out", "out", *_FORMATS[:6], "--sidecar", *_SMALL), _images, _VIDEOS
    ),
    "video": Command(
        ("video", "a.avi", "--out", "out/", *_VIDEO_FORMATS, "--format", "json", *_SMALL),
        _video,
        _VIDEOS,
    ),
    "train": Command(TRAIN, training, _TORCH),
    "export": Command(("export-onnx", "run.ckpt", "-o", "out/a.onnx"), _checkpoint, _ONNX),
    "models add": Command(_ADD, _new_model, _MODELS, "models"),
    "models add --force": Command((*_ADD, "--force"), _known_model, _MODELS, "models"),
    "convert": Command(("convert", "a.npy", "out/a.exr"), _array, _IMAGES),
}


def contents(folder: Path, command: Command) -> dict[str, bytes | None]:
    """Outputs by name, in a form that two runs share; None for one that is not whole."""
    root = folder / command.outputs
    names = (path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())
    return {name: steady(root / name) for name in names if "/." not in f"/{name}"}


def state(folder: Path) -> bytes:
    """A hash of all files, hidden ones too, that does not depend on seconds."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    contents = (
        steady(path) if path.suffix == ".ckpt" else _SECONDS.sub(b"", path.read_bytes())
        for path in files
    )
    return hashlib.sha256(repr([*zip(files, contents, strict=True)]).encode()).digest()


def hidden(folder: Path) -> list[str]:
    """Temporary files and folders, journals too."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob(".*"))


def steady(path: Path) -> bytes | None:
    """What a file says but for seconds; None if it is not whole."""
    try:
        if path.name == "manifest.jsonl":
            return b"\n".join(_row(line, path.parent) for line in path.read_bytes().splitlines())
        if path.name == "metrics.jsonl":
            rows = [json.loads(line) for line in path.read_bytes().splitlines()]
            return json.dumps([{**row, "seconds": 0} for row in rows]).encode()
        if path.suffix == ".ckpt":
            return _checkpoint_bytes(path)
    except (ValueError, KeyError, RuntimeError, OSError):
        return None
    return path.read_bytes()


def _row(line: bytes, out: Path) -> bytes:
    """A row that is true: what it names is there."""
    row = json.loads(line)
    for file in row["outputs"]:
        if hashlib.sha256((out / file["path"]).read_bytes()).hexdigest() != file["sha256"]:
            raise ValueError(file["path"])
    return json.dumps({**row, "seconds": 0}).encode()


def _checkpoint_bytes(path: Path) -> bytes:
    import torch  # noqa: PLC0415 - for one command only

    content = torch.load(path, weights_only=True)
    content["state"]["seconds"] = 0
    return repr(_plain(content)).encode()


def _plain(value: Any) -> Any:
    """Without what two files of the same content may differ in."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return value.numpy().tobytes() if hasattr(value, "numpy") else value


def copied(template: Path, folder: Path) -> None:
    """Make a fresh copy of what a command begins with."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(template, folder)
