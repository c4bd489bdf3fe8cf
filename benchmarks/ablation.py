"""What each loss of the paper does, at the same budget of steps; see docs/training.md.

Every row trains the same small efficient generator from the same seed on the same batches; only
the loss weights differ. Prints a Markdown table of the held-out scores; runs are resumable.
Run: ``python benchmarks/ablation.py --data DIR --out DIR [--epochs N] [--jobs N]``
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

SMALL = {
    "data.width": 128,
    "data.height": 96,
    "generator.encoder": [16, 32, 64, 96, 128],
    "generator.decoder": [64, 48, 32, 24],
    "optim.width_discriminator": 16,
    "optim.warmup_steps": 100,
    "optim.pool_size": 50,
    "loss.gradient": 0.0,
}
L1 = {"loss.l1": 10.0}
ROWS: dict[str, dict[str, object]] = {
    "L1": L1,
    "L1 + gradient": {**L1, "loss.gradient": 20.0},
    "L1 + contrast": {**L1, "loss.contrast_x": 0.5, "loss.contrast_y": 0.5},
    "L1 + cycle + identity": {**L1, "loss.cycle": 10.0, "loss.identity": 5.0},
    "L1 + adversarial": {**L1, "loss.adversarial": 1.0},
    "all of eq. 7": {
        **L1,
        "loss.contrast_x": 0.5,
        "loss.contrast_y": 0.5,
        "loss.cycle": 10.0,
        "loss.identity": 5.0,
        "loss.adversarial": 1.0,
    },
    "eq. 7 unpaired (λ6 = 0)": {
        "loss.l1": 0.0,
        "loss.contrast_x": 0.5,
        "loss.contrast_y": 0.5,
        "loss.cycle": 10.0,
        "loss.identity": 5.0,
        "loss.adversarial": 1.0,
        "data.paired": False,
    },
}
SHOWN = ("abs_rel", "rmse", "log10", "d1")


def train(item: tuple[str, dict[str, object]], options: argparse.Namespace) -> str:
    """Train one row and return its line of the table."""
    name, changes = item
    folder = options.out / name.replace(" ", "-").replace("/", "-")
    settings = {**SMALL, "optim.epochs_decay": options.epochs, "validate_every": options.epochs}
    settings |= {"seed": options.seed, **changes}
    command = [sys.executable, "-m", "depthcli", "train", "proposed", "--preset", "default"]
    command += ["--data", str(options.data), "--out", str(folder), "--threads", "1", "--quiet"]
    for key, value in settings.items():
        command += ["--set", f"{key}={value}"]
    subprocess.run(command, check=True)
    last = json.loads((folder / "metrics.jsonl").read_text("utf-8").splitlines()[-1])
    scores = " | ".join(f"{last['scores'][metric]:.4f}" for metric in SHOWN)
    return f"| {name} | {scores} | {last['seconds'] / 60:.1f} |"


def main() -> None:
    """Train all rows, a few at once, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--epochs", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"| losses | {' | '.join(SHOWN)} | minutes |")
    print("|---|" + "---|" * (len(SHOWN) + 1))
    with ThreadPoolExecutor(options.jobs) as pool:
        for line in pool.map(partial(train, options=options), ROWS.items()):
            print(line, flush=True)


if __name__ == "__main__":
    main()
