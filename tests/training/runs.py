"""What tests of whole runs share: the surroundings of a process, and checkpoints to compare."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import torch

ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": str(Path(__file__).parents[2]),
    "CUDA_VISIBLE_DEVICES": "",
}


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
