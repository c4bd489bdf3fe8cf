"""Average the weights of checkpoints of one network, for export.

Run ``python docs/mean_checkpoint.py OUT.ckpt A.ckpt B.ckpt``. Configuration and provenance are
those of the first. The mean of trainings from one start is often better than each (Wortsman et al.
2022, "Model soups").
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import torch

from depthcli.training.checkpoint import Checkpoint


def main(out: Path, *sources: Path) -> None:
    """Write the mean of the averaged weights."""
    found = [Checkpoint.load(source) for source in sources]
    states = [one.ema_generator or {} for one in found]
    mean = {
        name: torch.stack([state[name].float() for state in states]).mean(0)
        if value.is_floating_point()
        else value
        for name, value in states[0].items()
    }
    method = {f"generator.{name}": value for name, value in mean.items()}
    replace(found[0], ema_generator=mean, method=method, optimizers={}).save(out)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
