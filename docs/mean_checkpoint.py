"""Average the weights of checkpoints of one network, for export.

Run ``python docs/mean_checkpoint.py OUT.ckpt A.ckpt B.ckpt``. Configuration and provenance are
those of the first. The mean of trainings from one start is often better than each (Wortsman et al.
2022, "Model soups").
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from depthcli.lab.training.checkpoint import load_generator
from depthcli.lab.training.init_weights import load_init_weights


def main(out: Path, *sources: Path) -> None:
    """Write the mean of the averaged weights."""
    generator, first = load_generator(sources[0])
    load_init_weights(generator, sources, first.provenance)
    mean = generator.state_dict()
    method = {f"generator.{name}": value for name, value in mean.items()}
    replace(first, ema_generator=mean, method=method, optimizers={}).save(out)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
