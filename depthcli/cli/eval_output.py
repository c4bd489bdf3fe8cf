"""How an evaluation looks in a terminal: its progress, its table, its JSON and its CSV file."""

from __future__ import annotations

import math
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from depthcli.io.atomic import atomic_path
from depthcli.metrics.depth import METRICS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from depthcli.evaluation.nyu import Stage
    from depthcli.evaluation.report import Report, Row

_UNLIMITED = 10_000
_DECIMALS = {"silog": 2}


@contextmanager
def stages(*, quiet: bool) -> Iterator[Stage]:
    """Progress on stderr: a bar on a terminal, a line per stage elsewhere, nothing if quiet."""
    console = Console(stderr=True, quiet=quiet)
    if not console.is_terminal:
        yield _plain_stage(console)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as progress:

        def begin(what: str, steps: int) -> Callable[[], None]:
            task = progress.add_task(what, total=steps)
            return lambda: progress.advance(task)

        yield begin


def _plain_stage(console: Console) -> Stage:
    def begin(what: str, steps: int) -> Callable[[], None]:
        console.print(f"{what}: {steps} images", highlight=False)
        return lambda: None

    return begin


def show(report: Report, *, as_json: bool) -> None:
    """Print a report to stdout, as a table or as JSON."""
    if as_json:
        sys.stdout.write(report.to_json() + "\n")
        return
    console = Console(highlight=False)
    if not console.is_terminal:
        # A file or a pipe has no edge to wrap numbers at.
        console = Console(highlight=False, width=_UNLIMITED)
    console.print(Text(report.title, style="bold"))
    console.print(Text(report.protocol.description))
    console.print(_table(report))
    for note in _footnotes(report):
        console.print(Text(note))


def write_csv(report: Report, path: Path) -> None:
    """Write a report as CSV.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(report.to_csv(), encoding="utf-8")


def _table(report: Report) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("row", no_wrap=True)
    table.add_column("align", no_wrap=True)
    table.add_column("images", justify="right", no_wrap=True)
    for name, metric in METRICS.items():
        table.add_column(f"{name} {'↑' if metric.higher_is_better else '↓'}", justify="right")
    for row in report.rows:
        mark = "*" if row.note else ""
        align = row.alignment or "–"
        table.add_row(row.name + mark, align, str(row.image_count), *_cells(row))
    return table


def _cells(row: Row) -> list[str]:
    return [
        "–" if math.isnan(value) else f"{value:.{_DECIMALS.get(name, 4)}f}"
        for name, value in row.scores.items()
    ]


def _footnotes(report: Report) -> list[str]:
    marked = [f"* {row.note}" for row in report.rows if row.note]
    empty = {row.empty_count for row in report.rows} - {0}
    left_out = [f"{count} images have no valid pixel and are left out" for count in empty]
    return [*marked, *report.notes, *left_out]
