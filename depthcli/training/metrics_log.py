"""The metrics log of a run: one JSON object per epoch."""

import json
import math
import sys
from pathlib import Path
from typing import Any

from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.io.storage.atomic import append_whole, atomic_path
from depthcli.io.storage.regular import read_regular
from depthcli.training.checkpoint import TrainState


def append(path: Path, state: TrainState, losses: dict[str, float]) -> None:
    """Add the line of an epoch."""
    line = {
        "epoch": state.epoch,
        "step": state.step,
        "seconds": round(state.seconds, 1),
        "losses": losses,
        "scores": finite_or_none(state.scores),
    }
    with path.open("ab", buffering=0) as file:
        append_whole(file, json.dumps(line).encode() + b"\n")


def truncate(path: Path, step: int) -> None:
    """Remove lines after a step, which the resumed run writes again, and an incomplete line.

    Raises:
        OutputError: the log cannot be replaced; it is unchanged.
    """
    content = read_regular(path, sys.maxsize) if path.exists() else b""
    kept = b"".join(line + b"\n" for line in content.splitlines() if _step(line) <= step)
    if kept != content or path.is_symlink():  # a link is replaced, its target is not changed
        with atomic_path(path) as temporary:
            temporary.write_bytes(kept)


def _step(line: bytes) -> float:
    try:
        fields: Any = parsed_json(line)
        return validated(float, fields["step"])
    except (FieldError, TypeError, KeyError):
        return math.inf


def finite_or_none(scores: dict[str, float]) -> dict[str, float | None]:
    """Scores for JSON: a value that is not finite is None."""
    return {name: value if math.isfinite(value) else None for name, value in scores.items()}
