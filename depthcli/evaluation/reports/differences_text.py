"""The table of differences as text."""

import math
from collections.abc import Sequence

from depthcli.core.text import one_line
from depthcli.evaluation.differences import Difference, Interval
from depthcli.metrics.depth import METRICS


def differences_table(
    differences: Sequence[Difference], metrics: Sequence[str]
) -> tuple[str, list[list[str]]] | None:
    """Title and cells, header first, of the differences from one row; None if there are none.

    ``metrics`` are the names of the columns.
    """
    if not differences:
        return None
    name = one_line(differences[0].name)
    title = f"{name} minus each row, 95 % interval over scenes; ! excludes 0"
    lines = [["minus", "align", *metrics]]
    for difference in differences:
        intervals = dict(zip(METRICS, difference.intervals, strict=True))
        shown = [_interval_cell(intervals[metric]) for metric in metrics]
        lines.append([one_line(difference.other), difference.alignment or "-", *shown])
    return title, lines


def _interval_cell(interval: Interval) -> str:
    if math.isnan(interval.mean):
        return "-"
    if math.isnan(interval.low):
        return f"{interval.mean:+.4f} [-]"
    clear = "!" if interval.is_significant else ""
    return f"{interval.mean:+.4f}{clear} [{interval.low:+.4f},{interval.high:+.4f}]"
