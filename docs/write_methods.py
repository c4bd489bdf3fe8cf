"""Write the tables of results in docs/methods.md from the files of docs/results.

Run ``python docs/write_methods.py`` after a change of these files. ± is the sample standard
deviation over seeds; intervals are those of ``eval nyu --against``.
"""

from __future__ import annotations

import csv
import json
import re
import statistics
from pathlib import Path

PAGE = Path(__file__).with_name("methods.md")
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
    found: dict[str, list[_Row]] = {}
    for file_name in ("table-seed0.csv", "table-seed1.csv"):
        with (RESULTS / file_name).open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                name = re.sub(r"-seed\d+$", "", row["name"])
                is_old = file_name == "table-seed0.csv" and name in TRAINED_AGAIN
                if row["align"] == align and row["source"] != "published" and not is_old:
                    found.setdefault(name, []).append(row)
    return found | {name: found[name][:1] for name in MEANS}


def cell(row: list[_Row], metric: str) -> str:
    """Mean over seeds, and ± where there are several."""
    decimals, values = METRICS[metric], [float(one[metric]) for one in row]
    text = _number(statistics.mean(values), decimals)
    return text if len(values) == 1 else f"{text} ± {_number(statistics.stdev(values), decimals)}"


def table() -> str:
    """The scores in Markdown, without alignment and scaled to the median."""
    found, scaled = rows("none"), rows("median")
    texts = {name: (name, "") for name in MEANS}
    texts |= {name: (f"`{name}`", "no") for name in BASELINES}
    texts |= {"proposed": ("**`proposed`**", "used")} | CONTROLS
    lines = [["row", "pairs", *METRICS, *(f"{metric}, scaled" for metric in METRICS)]]
    lines.append(["---"] * len(lines[0]))
    for name, (text, used) in texts.items():
        cells = [cell(each[name], metric) for each in (found, scaled) for metric in METRICS]
        lines.append([text, used, *cells])
    return _markdown(lines)


def intervals() -> str:
    """The differences of `proposed` with seed 1 from each other row, without alignment."""
    differences = json.loads((RESULTS / "intervals-seed1.json").read_text("utf-8"))["differences"]
    found = {
        one["minus"].removesuffix("-seed1"): one["intervals"]
        for one in differences
        if one["align"] == "none"
    }
    lines = [["`proposed` minus", *METRICS]]
    lines.append(["---"] * len(lines[0]))
    texts = {"per-pixel mean": "per-pixel mean"} | {name: f"`{name}`" for name in BASELINES}
    for name, text in (texts | {name: text for name, (text, _) in CONTROLS.items()}).items():
        if name in found:
            lines.append([text, *(_interval(found[name][metric]) for metric in METRICS)])
    return _markdown(lines)


def page(text: str) -> str:
    """The page with the tables as they are now."""
    for new in (table(), intervals()):
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
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
