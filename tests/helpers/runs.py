"""What tests of whole runs share: the surroundings of a process, and checkpoints to compare."""

import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
import torch

from helpers.command_line import ROOT, InProcess
from helpers.rooms import write_rooms

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "CUDA_VISIBLE_DEVICES": ""}
HELD_OUT = "holdout_every = 4\nholdout_offset = 1\n"
RESNET_TOML = f"""
[generator]
width = 4
blocks = 1

[data]
width = 32
height = 32
{HELD_OUT}
[optim]
epochs_constant = 1
epochs_decay = 0
width_discriminator = 2
"""
"""Five steps in one epoch."""
EFFICIENT_TOML = f"""
[generator]
name = "efficient"
encoder = [8, 8, 8, 8, 8]
decoder = [8, 8, 8, 8]
depths = [1, 1, 1, 1]

[data]
width = 64
height = 48
{HELD_OUT}
[optim]
batch_size = 2
epochs_decay = 2
"""
"""Four steps in two epochs of the preset ``bundled``."""


def write_run(folder: Path, settings: str = EFFICIENT_TOML) -> Path:
    """The rooms in ``data``, and settings in ``tiny.toml``."""
    write_rooms(folder / "data")
    (folder / "tiny.toml").write_text(settings)
    return folder


def inside(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """A command that was run in a folder, without a process that loads torch once more."""
    threads = torch.get_num_threads()
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CUDA_VISIBLE_DEVICES", "")
        try:
            done = InProcess(ROOT, folder, folder / "models")(*words)
        finally:
            torch.set_num_threads(threads)
            for number, handler in handlers.items():
                signal.signal(number, handler)
    said = done.stdout.decode(), done.stderr.decode()
    return subprocess.CompletedProcess(words, done.returncode, *said)


def saved(folder: Path) -> dict[str, Any]:
    """The checkpoint of a run's folder, as it is in the file."""
    content: dict[str, Any] = torch.load(folder / "last.ckpt", weights_only=True)
    return content


def same(a: Any, b: Any) -> bool:
    """Whether two parts of checkpoints are equal to the last bit."""
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)
