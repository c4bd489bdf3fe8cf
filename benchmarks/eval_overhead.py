"""What ``depthcli eval nyu`` spends beyond the pipeline, on 1000 pairs.

The figure of merit is the wall time of the comparison divided by that of the pipeline alone on the
same pairs, with the same workers in the same process (at most 1.1). The pipeline alone reads
picture and depth of each pair and predicts; what evaluation adds is the choice of pixels, the
metrics and their sums. They take turns, 100 pairs each.
Run: ``python benchmarks/eval_overhead.py NYU [--pairs 1000] [--rounds 3]``
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tools import parse_options, print_spread, ratios, wall_s

from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.parallel import one_thread_each, ordered_map, usable_cores
from depthcli.core.types import Frame
from depthcli.inference.loading import SessionLoader
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.evaluation.evaluate import entry_for, score
from depthcli.lab.evaluation.predictors import open_model

if TYPE_CHECKING:
    from depthcli.lab.datasets.base import DepthDataset
    from depthcli.lab.evaluation.predictors import ModelPredictor

PART = 100


def run_pipeline(dataset: DepthDataset, positions: range, model: ModelPredictor) -> None:
    """All pictures through the pipeline, beside their depth."""

    def predict(position: int) -> None:
        dataset.depth_m(position)
        model.pipeline.predict(Frame(dataset.image(position)))

    workers = usable_cores()
    with one_thread_each(workers):
        for _ in ordered_map(predict, positions, workers=workers):
            pass


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, "data", pairs=1000, rounds=3)
    dataset = open_nyu(options.data)
    model = open_model(SessionLoader(threads=1), UpsamplingOptions(Upsampling.BILINEAR))
    ways = {
        "pipeline": lambda part: run_pipeline(dataset, part, model),
        "evaluation": lambda part: score(dataset, part, [entry_for(model)], workers=usable_cores()),
    }
    run_pipeline(dataset, range(20), model)
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(options.rounds):
        totals = dict.fromkeys(ways, 0.0)
        for turn, start in enumerate(range(0, options.pairs, PART)):
            part = range(start, min(start + PART, options.pairs))
            for name in list(ways)[:: -1 if turn % 2 else 1]:
                totals[name] += wall_s(lambda way=ways[name], part=part: way(part))
        for name, total in totals.items():
            seconds[name].append(total)
    for name, values in seconds.items():
        print_spread(name, values, "s")
    print_spread("evaluation / pipeline", ratios(seconds["evaluation"], seconds["pipeline"]))


if __name__ == "__main__":
    main()
