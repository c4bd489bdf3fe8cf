"""Write the tables of results in docs/methods.md and docs/benchmark.md from docs/results.

Run ``python docs/write_methods.py`` after a change of these files. ± is the sample standard
deviation over seeds; intervals are those of ``eval nyu --against``. The paper's figures are those
of ``depthcli.lab.evaluation.report``.
"""

from __future__ import annotations

import csv
import json
import re
import statistics
from collections.abc import Mapping
from pathlib import Path

from depthcli.lab.evaluation.report import PUBLISHED

PAGE = Path(__file__).with_name("methods.md")
BENCHMARK = Path(__file__).with_name("benchmark.md")
RESULTS = Path(__file__).with_name("results")
METRICS = {"abs_rel": 4, "rmse": 3, "d1": 4}
"""Metrics and their decimals."""
MEANS = ("constant mean", "per-pixel mean")
BASELINES = ("cyclegan", "cut", "fastcut", "dclgan", "simdcl", "hnegsrc")
CONTROLS = {  # name: (text, whether it uses pairs)
    "l1": ("L1 alone, equal steps", "used"),
    "l1-minutes": ("L1 alone, equal minutes", "used"),
    "no-residual": ("no last residual connection", "used"),
    "l1-10": ("λ6 = 10", "used"),
    "unpaired": ("unpaired (λ6 = 0)", "no"),
}
TRAINED_AGAIN = ("l1",)
"""Rows of the first file that were trained again with both seeds."""

_Row = dict[str, str]


def rows(align: str) -> dict[str, list[_Row]]:
    """The rows of each method or control, one a seed."""
    by_method: dict[str, list[_Row]] = {}
    for file_name in ("table-seed0.csv", "table-seed1.csv"):
        with (RESULTS / file_name).open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                name = re.sub(r"-seed\d+$", "", row["name"])
                is_old = file_name == "table-seed0.csv" and name in TRAINED_AGAIN
                if row["align"] == align and row["source"] != "published" and not is_old:
                    by_method.setdefault(name, []).append(row)
    return by_method | {name: by_method[name][:1] for name in MEANS}


def cell(row: list[_Row], metric: str) -> str:
    """Mean over seeds, and ± where there are several."""
    decimals, values = METRICS[metric], [float(value[metric]) for value in row]
    text = _number(statistics.mean(values), decimals)
    return text if len(values) == 1 else f"{text} ± {_number(statistics.stdev(values), decimals)}"


def table() -> str:
    """The scores in Markdown, without alignment and scaled to the median."""
    parts, scaled = rows("none"), rows("median")
    texts = {name: (name, "") for name in MEANS}
    texts |= {name: (f"`{name}`", "no") for name in BASELINES}
    texts |= {"proposed": ("**`proposed`**", "used")} | CONTROLS
    lines = [["row", "pairs", *METRICS, *(f"{metric}, scaled" for metric in METRICS)]]
    lines.append(["---"] * len(lines[0]))
    for name, (text, used) in texts.items():
        cells = [cell(each[name], metric) for each in (parts, scaled) for metric in METRICS]
        lines.append([text, used, *cells])
    return _markdown(lines)


def intervals(file_name: str, head: str, scaled: tuple[str, ...] = ()) -> str:
    """The differences of `proposed` from each other row, without alignment and ``scaled``."""
    differences = json.loads((RESULTS / file_name).read_text("utf-8"))["differences"]
    by_scaling: dict[str, dict[str, dict[str, dict[str, float]]]] = {"none": {}, "median": {}}
    for one in differences:
        by_scaling[one["align"]][one["minus"].removesuffix("-seed1")] = one["intervals"]
    lines = [[head, *METRICS, *(f"{metric}, scaled" for metric in scaled)]]
    lines.append(["---"] * len(lines[0]))
    texts = {"per-pixel mean": "per-pixel mean"}
    if scaled:  # over both seeds; the page has each baseline once
        texts |= {name: f"`{name}`" for name in BASELINES}
    for name, text in (texts | {name: text for name, (text, _) in CONTROLS.items()}).items():
        if name in by_scaling["none"]:
            cells = [_interval(by_scaling["none"][name][metric]) for metric in METRICS]
            more = (_interval(by_scaling["median"][name][metric]) for metric in scaled)
            lines.append([text, *cells, *more])
    return _markdown(lines)


def test_rows(align: str) -> dict[str, _Row]:
    """The scores on the paper's 449 test pairs by name, without ``-seed1``."""
    with (RESULTS / "test-449.csv").open(encoding="utf-8", newline="") as file:
        matching = [row for row in csv.DictReader(file) if row["align"] == align]
    return {row["name"].removesuffix("-seed1"): row for row in matching}


def benchmark() -> str:
    """The paper's figures beside ours, on the test pairs and on validation."""
    paper = {row.name.split()[0].lower(): row.scores for row in PUBLISHED}
    parts, scaled = test_rows("none"), test_rows("median")
    validation = rows("none"), rows("median")
    columns = ["paper", "here", "here, scaled", "here, validation", "validation, scaled"]
    lines = [["row", *columns], ["---"] * (1 + len(columns))]
    names = {"per-pixel mean": "per-pixel mean"} | {name: f"`{name}`" for name in BASELINES}
    names |= {"proposed": "**`proposed`**"} | {name: text for name, (text, _) in CONTROLS.items()}
    for name, text in names.items():
        cells = [_scores(dict(paper[name].items())) if name in paper else ""]
        cells += [_scores(each[name]) for each in (parts, scaled)]
        lines.append([text, *cells, *(_first_seed(each[name]) for each in validation)])
    return _markdown(lines)


def test_table() -> str:
    """Six metrics of the paper, of ours without alignment and of ours scaled to the median."""
    metrics = ("abs_rel", "rmse", "rms_log", "d1", "d2", "d3")
    lines = [["row", "source", *metrics], ["---"] * (2 + len(metrics))]
    paper = {row.name.split()[0].lower(): dict(row.scores.items()) for row in PUBLISHED}
    scaled = test_rows("median")
    for name, names in test_rows("none").items():
        sources = {"paper": paper[name]} if name in paper else {}
        for source, row in (sources | {"here": names, "scaled": scaled[name]}).items():
            scores = (_number(float(row[metric]), 4) for metric in metrics)
            lines.append([f"`{names['name']}`", source, *scores])
    return _markdown(lines)


def _first_seed(found: list[_Row]) -> str:
    """Scores of seed 1, or of the only seed."""
    return _scores(found[-1])


def _scores(row: Mapping[str, str | float]) -> str:
    return " / ".join(_number(float(row[metric]), digits) for metric, digits in METRICS.items())


def tables() -> dict[Path, tuple[str, ...]]:
    """The tables of each page."""
    return {
        PAGE: (
            table(),
            intervals("intervals-seed1.json", "`proposed` minus"),
            intervals("intervals-seeds.json", "`proposed` minus, both seeds", ("abs_rel",)),
        ),
        BENCHMARK: (benchmark(), test_table()),
    }


def page(text: str, *tables: str) -> str:
    """The page with its tables replaced by these, each found by its first line."""
    for new in tables:
        head = f"\n{new.splitlines()[0]}\n"
        start = text.index(head) + 1
        text = text[:start] + new + text[text.index("\n\n", start) :]
    return text


def _markdown(lines: list[list[str]]) -> str:
    return "\n".join(
        f"|{'|'.join(line)}|" if line[0] == "---" else f"| {' | '.join(line)} |" for line in lines
    )


def _interval(interval: dict[str, float]) -> str:
    mean, low, high = (_signed(interval[name]) for name in ("mean", "low", "high"))
    return f"{mean} ({low} to {high})"


def _signed(value: float) -> str:
    return ("−" if value < 0 else "+") + _number(abs(value), 3)


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}".removeprefix("0")


if __name__ == "__main__":
    for path, new in tables().items():
        path.write_text(page(path.read_text(encoding="utf-8"), *new), encoding="utf-8")
