"""Draw learning curves: a metric of held-out pictures over the training, one line a run.

Runs can have different numbers of epochs. Run ``python docs/draw_curves.py curves.svg
runs/table/*`` with matplotlib.
"""

from __future__ import annotations

import argparse
import json
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot as plt


def curve(log: Path, metric: str) -> tuple[list[float], list[float]]:
    """The metric after each epoch that was validated, and the share of the epochs then."""
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    done = [line for line in lines if metric in line["scores"]]
    # Some logs repeat the scores of the epoch that was validated last.
    done = [
        line for before, line in pairwise([{}, *done]) if line["scores"] != before.get("scores")
    ]
    last = lines[-1]["epoch"]
    return [line["epoch"] / last for line in done], [line["scores"][metric] for line in done]


def main() -> None:
    """Read the logs of runs and draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="picture to write; the suffix is its format")
    parser.add_argument("runs", type=Path, nargs="+", help="runs, each with metrics.jsonl")
    parser.add_argument("--metric", default="abs_rel")
    parser.add_argument("--top", type=float, help="highest value that is shown")
    arguments = parser.parse_args()
    mpl.rcParams |= {"svg.hashsalt": "depthcli", "svg.fonttype": "none"}
    figure, axes = plt.subplots(figsize=(8, 4.5))
    colours = mpl.rcParams["axes.prop_cycle"]
    axes.set_prop_cycle(plt.cycler(linestyle=["-", "--"]) * colours)
    for run in sorted(arguments.runs):
        points = curve(run / "metrics.jsonl", arguments.metric)
        axes.plot(*points, marker=".", label=run.name)
    axes.set(xlabel="share of the epochs", ylabel=f"{arguments.metric}, held-out scenes")
    axes.set_ylim(top=arguments.top)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1))
    figure.savefig(arguments.picture, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    main()
