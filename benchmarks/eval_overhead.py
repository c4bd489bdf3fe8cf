"""What ``depthcli eval nyu`` spends beyond the pipeline, on 1000 pairs.

The figure of merit is the wall time of the comparison divided by that of the pipeline alone on the
same pairs, with the same workers in the same process (at most 1.1). The pipeline alone reads
picture and depth of each pair and predicts; what evaluation adds is the choice of pixels, the
metrics and their sums. For comparison, the pipeline on the pictures alone, as far as depth and as
far as the 16-bit PNG that ``batch`` writes, and the whole command on its ``val`` split, with
start-up and the trivial rows' training mean.
Run: ``python benchmarks/eval_overhead.py NYU [--pairs 1000] [--rounds 3]``
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.parallel import one_thread_each, ordered_map, usable_cores
from depthcli.core.types import Frame
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.png16 import Png16Writer
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.evaluation.evaluate import entry_for, score
from depthcli.lab.evaluation.predictors import open_model

if TYPE_CHECKING:
    from collections.abc import Callable

    from depthcli.lab.datasets.base import DepthDataset
    from depthcli.lab.evaluation.predictors import ModelPredictor

PART = 100


def run_pipeline(
    dataset: DepthDataset,
    positions: range,
    model: ModelPredictor,
    *,
    with_depth: bool = False,
    out: Path | None = None,
) -> None:
    """All pictures through the pipeline; what comes out is written, if there is a folder."""
    writer = Png16Writer()

    def one(position: int) -> None:
        if with_depth:
            dataset.depth_m(position)
        depth = model.pipeline.predict(Frame(dataset.image(position))).depth
        if out is not None:
            writer.write(depth, out / f"{position}.png")

    workers = usable_cores()
    with one_thread_each(workers):
        for _ in ordered_map(one, positions, workers=workers):
            pass


def seconds(action: Callable[[], object]) -> float:
    """Wall time."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def one_round(ways: dict[str, Callable[[range], object]], pairs: int) -> dict[str, float]:
    """Seconds that each way takes for so many pairs."""
    total = dict.fromkeys(ways, 0.0)
    for turn, start in enumerate(range(0, pairs, PART)):
        part = range(start, min(start + PART, pairs))
        for name in list(ways)[:: -1 if turn % 2 else 1]:
            total[name] += seconds(lambda way=ways[name], part=part: way(part))
    return total


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    dataset = open_nyu(options.data)
    model = open_model(SessionLoader(threads=1), UpsamplingOptions(Upsampling.BILINEAR))
    folder = tempfile.TemporaryDirectory()
    out = Path(folder.name)
    ways: dict[str, Callable[[range], object]] = {
        "pipeline, pictures": lambda part: run_pipeline(dataset, part, model),
        "pipeline, to PNG": lambda part: run_pipeline(dataset, part, model, out=out),
        "pipeline, pairs": lambda part: run_pipeline(dataset, part, model, with_depth=True),
        "evaluation": lambda part: score(dataset, part, [entry_for(model)], workers=usable_cores()),
    }
    run_pipeline(dataset, range(20), model, with_depth=True)
    found: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(options.rounds):
        for name, total in one_round(ways, options.pairs).items():
            found[name].append(total)
    command = (sys.executable, "-m", "depthcli", "eval", "nyu", "--data", str(options.data))
    whole = (*command, "--split", "val", "--limit", "134")
    found["whole command"] = [
        seconds(lambda: subprocess.run(whole, check=True, capture_output=True))
        for _ in range(options.rounds)
    ]
    for name, values in found.items():
        print(
            f"{name:20} {statistics.median(values):7.2f} s  ({min(values):.2f}-{max(values):.2f})"
        )
    folder.cleanup()
    for base in ("pipeline, pairs", "pipeline, to PNG", "pipeline, pictures"):
        ratios = [b / a for a, b in zip(found[base], found["evaluation"], strict=True)]
        middle = statistics.median(ratios)
        print(f"evaluation / {base}: {middle:.3f}  ({min(ratios):.3f}-{max(ratios):.3f})")


if __name__ == "__main__":
    main()
