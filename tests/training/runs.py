"""What tests of whole runs share: the surroundings of a process, and checkpoints to compare."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from collections.abc import Sequence

ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(Path(__file__).parents[2]),
    "CUDA_VISIBLE_DEVICES": "",
}


def finished(
    command: Sequence[str], folder: Path, **options: Any
) -> subprocess.CompletedProcess[str]:
    """A command that was run in a folder to its end."""
    settings = {"env": ENVIRONMENT, "capture_output": True, "text": True, "timeout": 120, **options}
    return subprocess.run(command, cwd=folder, check=False, **settings)


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
