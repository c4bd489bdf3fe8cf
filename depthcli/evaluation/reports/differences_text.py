"""The table of differences as text."""

import math
from collections.abc import Sequence

from depthcli.core.text import one_line
from depthcli.evaluation.differences import Difference
from depthcli.metrics.depth import METRICS

_FEW_SCENES = 12
"""In simulations with fewer, the intervals hold the true difference in less than 90 % of cases."""


def differences_table(
    differences: Sequence[Difference], metrics: Sequence[str]
) -> tuple[str, list[list[str]]] | None:
    """Title and cells, header first, of the differences from one row; None if there are none.

    Three lines for each difference: the mean and the bounds of its interval.

    ``metrics`` are the names of the columns.
    """
    if not differences:
        return None
    name, scenes = one_line(differences[0].name), differences[0].scene_count
    title = f"{name} minus each row: mean and 95 % interval over {scenes} scenes; ! excludes 0"
    if scenes == 1:
        title = f"{name} minus each row: mean; 1 scene: no interval"
    elif scenes < _FEW_SCENES:
        title += "; of so few, the intervals are too narrow"
    lines = [["minus", "align", "", *metrics]]
    for difference in differences:
        intervals = dict(zip(METRICS, difference.intervals, strict=True))
        shown = [intervals[metric] for metric in metrics]
        row = (one_line(difference.other), difference.alignment or "-")
        lines += [
            [*row, "mean", *(_cell(one.mean, "!" if one.is_significant else " ") for one in shown)],
            ["", "", "low", *(_cell(one.low) for one in shown)],
            ["", "", "high", *(_cell(one.high) for one in shown)],
        ]
    return title, lines


def _cell(value: float, mark: str = " ") -> str:
    """A number with a last character that keeps the digits of a column in line."""
    return ("-" if math.isnan(value) else f"{value:+.4f}") + mark
